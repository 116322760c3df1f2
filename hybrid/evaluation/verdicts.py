"""What an evaluation's figures say, in words."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid.evaluation.budgets import NEAR
from hybrid.evaluation.entries import OURS
from hybrid.measure.quality import METRICS, half_name

Key = tuple[str, str]
# What the fovea is judged by, and what the whole frame is.
_FOVEAL, _FALLBACK, WHOLE_METRIC = ("jod", "flip"), ("ssim", "psnr"), "ssim"
_NAMES = {"jod": "FovVideoVDP", "flip": "FLIP", "ssim": "SSIM", "psnr": "PSNR", "lpips": "LPIPS"}


def values_of(found: dict[str, Any], key: Key, region: str, metric: str) -> list[float]:
    """Of a method and budget, one per view, in the order of views."""
    rows = [
        row
        for row in found["quality"]
        if (row["method"], row["budget"], row["region"], row["metric"]) == (*key, region, metric)
    ]
    return [row["value"] for row in sorted(rows, key=lambda row: row["view"])]


def mean_of(found: dict[str, Any], key: Key, region: str, metric: str) -> float | None:
    """Mean over the views, None where it was not measured."""
    values = values_of(found, key, region, metric)
    return float(np.mean(values)) if values else None


def fused_by_spp(found: dict[str, Any], metric: str) -> dict[int, float | None]:
    """Foveal quality of the fused frames, by their samples per pixel."""
    return {
        row["spp"]: mean_of(found, (row["method"], row["budget"]), "foveal", metric)
        for row in found["methods"]
        if row.get("fovea") == "fused"
    }


def keys_of(found: dict[str, Any]) -> list[Key]:
    """Methods and budgets, in the order in which they were made."""
    return list(dict.fromkeys((row["method"], row["budget"]) for row in found["methods"]))


def is_better(metric: str, ours: float, theirs: float) -> bool:
    """Whether the first of two values is the better one."""
    return ours > theirs if METRICS[metric] else ours < theirs


def foveal_metrics(found: dict[str, Any]) -> list[str]:
    """What the fovea is judged by: FovVideoVDP and FLIP, SSIM and PSNR where neither is installed."""
    measured = {row["metric"] for row in found["quality"]}
    return [m for m in _FOVEAL if m in measured] or [m for m in _FALLBACK if m in measured]


def rivals_of(found: dict[str, Any]) -> list[Key]:
    """Peers that cost no more than ours: at equal time, or without any rays and no slower."""
    times = {(row["method"], row["budget"]): row["ms"]["p50"] for row in found["time"]}
    rays = {(row["method"], row["budget"]): row["rays"] for row in found["methods"]}
    ours = times.get((OURS, "fixed"), np.inf)
    return [
        key
        for key in keys_of(found)
        if key[1] == "equal-time" or (rays[key] == 0 and times.get(key, 0.0) <= ours * (1 + NEAR))
    ]


def verdicts(found: dict[str, Any]) -> list[str]:
    """Sentences for the top of the report: first where this project's frame is not ahead."""
    metrics = foveal_metrics(found)
    compared = [_compared(found, "foveal", metric) for metric in metrics]
    compared.append(_compared(found, "whole", WHOLE_METRIC))
    by_outcome = [sentence for outcome in zip(*compared, strict=True) for sentence in outcome if sentence]
    return [*by_outcome, *_against_rmfr(found), *_against_splats(found, metrics)]


def _compared(found: dict[str, Any], region: str, metric: str) -> tuple[str, str, str]:
    """Whom our frame is not ahead of, from whom it cannot be told apart, and whom it is ahead of.

    Told apart are two methods where both halves of the references say the same of them as the whole.
    """
    ours = mean_of(found, (OURS, "fixed"), region, metric)
    if ours is None:
        return "", "", ""
    said: dict[bool | None, list[str]] = {False: [], None: [], True: []}
    for key in rivals_of(found):
        theirs = mean_of(found, key, region, metric)
        if theirs is not None:
            wins = _wins(found, key, region, metric)
            said[_is_ahead(found, key, region, metric)].append(f"{key[0]} ({theirs:.4g}; {wins})")
    place = "In the fovea" if region == "foveal" else "Over the whole frame"
    start = f"{place}, by {_NAMES[metric]}, the hybrid frame ({ours:.4g})"
    lost, close, won = (_listed(said[outcome]) for outcome in (False, None, True))
    return (
        f"{start} is not ahead of {lost}." if lost else "",
        f"{start} cannot be told apart from {close}: the references' halves do not agree." if close else "",
        f"{start} is ahead of {won}." if won else "",
    )


def _is_ahead(found: dict[str, Any], key: Key, region: str, metric: str) -> bool | None:
    """Whether our frame is better than a peer's on the mean over the views; None where that is open."""
    outcomes = set()
    for name in (metric, half_name(metric, 1), half_name(metric, 2)):
        ours, theirs = (mean_of(found, k, region, name) for k in ((OURS, "fixed"), key))
        if ours is not None and theirs is not None:
            outcomes.add(is_better(metric, ours, theirs))
    return outcomes.pop() if len(outcomes) == 1 else None


def _wins(found: dict[str, Any], key: Key, region: str, metric: str) -> str:
    """In how many views our frame is better than a peer's: a mean alone says little where few differ."""
    pairs = zip(*(values_of(found, k, region, metric) for k in ((OURS, "fixed"), key)), strict=True)
    better = [is_better(metric, ours, theirs) for ours, theirs in pairs]
    return f"better in {sum(better)} of {len(better)} views"


def _against_rmfr(found: dict[str, Any]) -> list[str]:
    """How many views have the higher SSIM, as Foveated Path Culling counts them."""
    ours = values_of(found, (OURS, "fixed"), "whole", WHOLE_METRIC)
    theirs = values_of(found, ("rmfr, tuned", "equal-time"), "whole", WHOLE_METRIC)
    if not theirs:
        return []
    wins = sum(a > b for a, b in zip(ours, theirs, strict=True))
    return [
        f"SSIM of the whole frame is higher than that of RMFR, tuned and at equal time, in {wins} of "
        f"{len(ours)} views (Foveated Path Culling: 2 of 5, untuned)."
    ]


def _against_splats(found: dict[str, Any], metrics: list[str]) -> list[str]:
    """From how many samples on the fused fovea passes the splats under it."""
    sentences = []
    for metric in metrics:
        splats = mean_of(found, ("splats alone", "fixed"), "foveal", metric)
        if splats is None:
            continue
        by_spp = fused_by_spp(found, metric)
        ahead = {spp: ours is not None and is_better(metric, ours, splats) for spp, ours in by_spp.items()}
        # From there on: more samples that are worse again would not be passing.
        passing = [spp for spp in sorted(ahead) if all(ahead[more] for more in ahead if more >= spp)]
        if passing:
            said = (
                f"from {passing[0]} samples per pixel on" if passing[0] > 1 else "even at 1 sample per pixel"
            )
        else:
            said = f"at none of {_listed([str(spp) for spp in sorted(by_spp)])} samples per pixel"
        sentences.append(f"By {_NAMES[metric]} the fused fovea is better than splats alone {said}.")
    return sentences


def _listed(names: list[str]) -> str:
    return "".join(names) if len(names) < 2 else ", ".join(names[:-1]) + " and " + names[-1]
