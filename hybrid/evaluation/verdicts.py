"""The results of an evaluation in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hybrid.evaluation.keys import EQUAL_TIME, FIXED, OURS_KEY, Key, half_name
from hybrid.evaluation.results import (
    affordable_baselines,
    foveal_metric_names,
    fused_by_spp,
    is_better,
    mean_of,
    missed_time,
    outcomes_of,
)

# The metric that whole frames are compared by.
WHOLE_METRIC = "ssim"
_NAMES = {"jod": "FovVideoVDP", "flip": "FLIP", "ssim": "SSIM", "psnr": "PSNR", "lpips": "LPIPS"}


def verdicts(found: dict[str, Any]) -> list[str]:
    """Sentences for the top of the report; those about baselines that are better come first.

    Args:
        found: the content of evaluation.json.
    """
    metrics = foveal_metric_names(found)
    comparisons = [_compared(found, "foveal", metric) for metric in metrics]
    comparisons.append(_compared(found, "whole", WHOLE_METRIC))
    by_outcome = [
        *(one.behind() for one in comparisons),
        *(one.undecided() for one in comparisons),
        *(one.ahead() for one in comparisons),
    ]
    return [*filter(None, by_outcome), *_against_rmfr(found), *_against_splats(found, metrics)]


@dataclass(frozen=True)
class _Comparison:
    """Our frame against the affordable baselines, by one metric of one region.

    Attributes:
        start: beginning of each sentence.
        baselines: texts about the baselines that it is ahead of (True), not ahead of (False), and that it
            cannot be distinguished from (None).
    """

    start: str
    baselines: dict[bool | None, list[str]]

    def behind(self) -> str:
        """A sentence about the baselines that our frame is not ahead of; empty if there are none."""
        names = _listed(self.baselines[False])
        return f"{self.start} is not ahead of {names}." if names else ""

    def undecided(self) -> str:
        """A sentence about those that it cannot be distinguished from."""
        names = _listed(self.baselines[None])
        because = "the difference is within the noise of the references"
        return f"{self.start} cannot be distinguished from {names}: {because}." if names else ""

    def ahead(self) -> str:
        """A sentence about those that it is ahead of."""
        names = _listed(self.baselines[True])
        return f"{self.start} is ahead of {names}." if names else ""


def _compared(found: dict[str, Any], region: str, metric: str) -> _Comparison:
    outcomes: dict[bool | None, list[str]] = {True: [], False: [], None: []}
    where = "In the fovea" if region == "foveal" else "Over the whole frame"
    ours = mean_of(found, OURS_KEY, region, metric)
    if ours is None:
        return _Comparison(where, outcomes)
    for key in affordable_baselines(found):
        theirs = mean_of(found, key, region, metric)
        if theirs is not None:
            wins = _wins(found, key, region, metric)
            missed = missed_time(found, key)
            marked = f"; {missed} than the hybrid frame" if missed else ""
            outcomes[_is_ahead(found, key, region, metric)].append(
                f"{key.method} ({theirs:.4g}; {wins}{marked})"
            )
    return _Comparison(f"{where}, by {_NAMES[metric]}, the hybrid frame ({ours:.4g})", outcomes)


def _is_ahead(found: dict[str, Any], key: Key, region: str, metric: str) -> bool | None:
    """Whether our frame is better than a baseline on the mean over the views.

    Returns:
        None if they do not differ, or if either half of the references says otherwise than the whole.
    """
    outcomes: set[bool | None] = set()
    for name in (metric, half_name(metric, 1), half_name(metric, 2)):
        ours, theirs = (mean_of(found, k, region, name) for k in (OURS_KEY, key))
        if ours is not None and theirs is not None:
            outcomes.add(None if ours == theirs else is_better(metric, ours, theirs))
    return outcomes.pop() if len(outcomes) == 1 else None


def _wins(found: dict[str, Any], key: Key, region: str, metric: str) -> str:
    """In how many views our frame is better: a mean alone says little if it is due to a few of them."""
    return f"better {_counted(outcomes_of(found, key, region, metric))}"


def _counted(outcomes: list[bool | None]) -> str:
    """In how many views something holds, and in how many that cannot be told."""
    ties = outcomes.count(None)
    open_ = f", too close to tell in {ties}" if ties else ""
    return f"in {outcomes.count(True)} of {len(outcomes)} views{open_}"


def _against_rmfr(found: dict[str, Any]) -> list[str]:
    """How many views have the higher SSIM, which is how Foveated Path Culling (FPC) counts."""
    rmfr = Key("rmfr, tuned", EQUAL_TIME)
    outcomes = outcomes_of(found, rmfr, "whole", WHOLE_METRIC)
    if not outcomes:
        return []
    missed = missed_time(found, rmfr)
    budget = f"tuned and {missed} than the hybrid frame" if missed else "tuned and at equal time"
    return [
        "SSIM of the whole frame is higher than that of rectangular mapping-based foveated rendering (RMFR), "
        f"{budget}, {_counted(outcomes)} (Foveated Path Culling: 2 of 5, untuned)."
    ]


def _against_splats(found: dict[str, Any], metrics: list[str]) -> list[str]:
    """From how many samples on the fused fovea surpasses the splats under it."""
    sentences = []
    for metric in metrics:
        splats = mean_of(found, Key("splats alone", FIXED), "foveal", metric)
        if splats is None:
            continue
        by_spp = fused_by_spp(found, metric)
        better = {spp: ours is not None and is_better(metric, ours, splats) for spp, ours in by_spp.items()}
        # A count does not qualify if a higher one is worse again.
        counts = [spp for spp in sorted(better) if all(better[more] for more in better if more >= spp)]
        if counts:
            when = f"from {counts[0]} samples per pixel on" if counts[0] > 1 else "even at 1 sample per pixel"
        else:
            when = f"at none of {_listed([str(spp) for spp in sorted(by_spp)])} samples per pixel"
        sentences.append(f"By {_NAMES[metric]}, the fused fovea is better than splats alone {when}.")
    return sentences


def _listed(names: list[str]) -> str:
    return "".join(names) if len(names) < 2 else ", ".join(names[:-1]) + " and " + names[-1]
