"""What an evaluation's figures say, in words."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid.evaluate.entries import OURS
from hybrid.evaluate.measure import METRICS

Key = tuple[str, str]
# What the fovea is judged by, and what the whole frame is.
FOVEAL_METRICS, WHOLE_METRIC = ("jod", "flip"), "ssim"
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


def rivals_of(found: dict[str, Any]) -> list[Key]:
    """Peers that cost no more than ours: those at equal time, and those that trace nothing."""
    traceless = {(row["method"], row["budget"]) for row in found["methods"] if row["rays"] == 0}
    return [key for key in keys_of(found) if key[1] == "equal-time" or key in traceless]


def verdicts(found: dict[str, Any]) -> list[str]:
    """Sentences for the top of the report: first where this project's frame is not ahead."""
    behind, ahead = [], []
    for metric in FOVEAL_METRICS:
        ours = mean_of(found, (OURS, "fixed"), "foveal", metric)
        if ours is None:
            continue
        lost: list[str] = []
        won: list[str] = []
        for key in rivals_of(found):
            theirs = mean_of(found, key, "foveal", metric)
            if theirs is not None:
                said = f"{key[0]} ({theirs:.4g}; {_wins(found, key, metric)})"
                (won if is_better(metric, ours, theirs) else lost).append(said)
        where = f"In the fovea, by {_NAMES[metric]}, the hybrid frame ({ours:.4g})"
        if lost:
            behind.append(f"{where} is not ahead of {_listed(lost)}.")
        if won:
            ahead.append(f"{where} is ahead of {_listed(won)}.")
    return [*behind, *ahead, *_against_rmfr(found), *_against_splats(found)]


def _wins(found: dict[str, Any], key: Key, metric: str) -> str:
    """In how many views our fovea is better than a peer's: a mean alone says little where few differ."""
    pairs = zip(*(values_of(found, k, "foveal", metric) for k in ((OURS, "fixed"), key)), strict=True)
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


def _against_splats(found: dict[str, Any]) -> list[str]:
    """From how many samples on the fused fovea passes the splats under it."""
    sentences = []
    for metric in FOVEAL_METRICS:
        splats = mean_of(found, ("splats alone", "fixed"), "foveal", metric)
        if splats is None:
            continue
        by_spp = fused_by_spp(found, metric)
        passing = [
            spp
            for spp, ours in sorted(by_spp.items())
            if ours is not None and is_better(metric, ours, splats)
        ]
        if passing:
            said = (
                f"from {passing[0]} samples per pixel on" if passing[0] > 1 else "even at 1 sample per pixel"
            )
        else:
            said = f"at none of {_listed([str(spp) for spp in sorted(by_spp)])} samples per pixel"
        sentences.append(f"By {_NAMES[metric]} the fused fovea is better than splats alone {said}.")
    return sentences


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
