"""The results of an evaluation, as evaluation.json has them: values looked up, and verdicts in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid.evaluation.equal_cost import TOLERANCE
from hybrid.evaluation.result_keys import EQUAL_TIME, FIXED, OURS_KEY, Key, half_name
from hybrid.measure.frame_quality import METRICS

# Metrics that the fovea is compared by, and those used if neither is installed.
_FOVEAL, _FALLBACK = ("jod", "flip"), ("ssim", "psnr")


def keys_of(found: dict[str, Any]) -> list[Key]:
    """Methods and budgets, in the order in which they were measured."""
    return list(dict.fromkeys(Key(row["method"], row["budget"]) for row in found["methods"]))


def values_of(found: dict[str, Any], key: Key, region: str, metric: str) -> list[float]:
    """Values of a method and budget, one per view, in the order of views."""
    by_view = _by_view(found, key, region, metric)
    return [by_view[view] for view in sorted(by_view)]


def _by_view(found: dict[str, Any], key: Key, region: str, metric: str) -> dict[int, float]:
    """Values of a method and budget by view."""
    return {
        row["view"]: row["value"]
        for row in found["quality"]
        if (row["method"], row["budget"], row["region"], row["metric"]) == (*key, region, metric)
    }


def mean_of(found: dict[str, Any], key: Key, region: str, metric: str) -> float | None:
    """Mean over the views; None if it was not measured."""
    values = values_of(found, key, region, metric)
    return float(np.mean(values)) if values else None


def times_of(found: dict[str, Any]) -> dict[Key, float]:
    """Median milliseconds of the methods and budgets that were timed."""
    return {Key(row["method"], row["budget"]): row["ms"]["p50"] for row in found["time"]}


def fused_by_spp(found: dict[str, Any], metric: str) -> dict[int, float | None]:
    """Foveal quality of fused frames by samples per pixel."""
    return {
        row["spp"]: mean_of(found, Key(row["method"], row["budget"]), "foveal", metric)
        for row in found["methods"]
        if row.get("fovea") == "fused"
    }


def foveal_metric_names(found: dict[str, Any]) -> list[str]:
    """Metrics that the fovea is compared by: FovVideoVDP and FLIP; SSIM and PSNR if neither is installed."""
    measured = {row["metric"] for row in found["quality"]}
    return [m for m in _FOVEAL if m in measured] or [m for m in _FALLBACK if m in measured]


def is_better(metric: str, ours: float, theirs: float) -> bool:
    """Whether the first of two values is the better one."""
    return ours > theirs if METRICS[metric] else ours < theirs


def noise_of(found: dict[str, Any], key: Key, region: str, metric: str) -> float:
    """Noise of the difference between our frame and another method in one view; 0 if no halves were measured.

    Each half of a reference's samples yields a difference of its own. Half of what the two differ by is the
    standard error of their mean; the root mean square over the views is the noise.
    """
    halves = [_differences(found, key, region, half_name(metric, number)) for number in (1, 2)]
    spreads = [(halves[0][view] - halves[1][view]) / 2 for view in halves[0].keys() & halves[1].keys()]
    return float(np.sqrt(np.mean(np.square(spreads)))) if spreads else 0.0


def outcomes_of(found: dict[str, Any], key: Key, region: str, metric: str) -> list[bool | None]:
    """Whether our frame is better than another method, view by view.

    Returns:
        None of a view where the two differ by no more than twice the noise.
    """
    least = 2 * noise_of(found, key, region, metric)
    differences = _differences(found, key, region, metric).values()
    return [None if abs(one) <= least else is_better(metric, one, 0.0) for one in differences]


def _differences(found: dict[str, Any], key: Key, region: str, metric: str) -> dict[int, float]:
    """Our values minus those of another method, by view, where both were measured."""
    ours, theirs = (_by_view(found, one, region, metric) for one in (OURS_KEY, key))
    return {view: ours[view] - theirs[view] for view in sorted(ours.keys() & theirs.keys())}


def time_over_ours(found: dict[str, Any], key: Key) -> float | None:
    """Median time of a method over ours; None if either was not timed."""
    for row in found["time"]:
        if (row["method"], row["budget"]) == key and "over_ours" in row:
            return float(row["over_ours"])
    times = times_of(found)
    return times[key] / times[OURS_KEY] if key in times and OURS_KEY in times else None


def missed_time(found: dict[str, Any], key: Key) -> str:
    """How far a baseline at equal time is from it, such as "20 % slower"; empty if it is within TOLERANCE."""
    ratio = time_over_ours(found, key) if key.budget == EQUAL_TIME else None
    if ratio is None or abs(ratio - 1) <= TOLERANCE + 1e-9:  # 1.03 - 1 is a little more than 0.03
        return ""
    return f"{100 * abs(ratio - 1):.0f} % {'slower' if ratio > 1 else 'faster'}"


def budget_label(found: dict[str, Any], key: Key) -> str:
    """The budget as tables show it: equal time is not called equal where it was missed."""
    missed = missed_time(found, key)
    return f"{key.budget}, missed: {missed}" if missed else key.budget


def label_of(found: dict[str, Any], key: Key) -> str:
    """A method as it is named in lists, with the budget that it met."""
    missed = missed_time(found, key)
    return f"{key.method} ({budget_label(found, key)})" if missed else key.label


def affordable_baselines(found: dict[str, Any]) -> list[Key]:
    """Baselines that cost no more than our frame: at equal time, or without any rays and no slower."""
    times = times_of(found)
    rays = {Key(row["method"], row["budget"]): row["rays"] for row in found["methods"]}
    ours = times.get(OURS_KEY, np.inf)
    return [
        key
        for key in keys_of(found)
        if key.budget == EQUAL_TIME or (rays[key] == 0 and times.get(key, 0.0) <= ours * (1 + TOLERANCE))
    ]


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
