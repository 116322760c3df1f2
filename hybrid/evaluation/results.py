"""Looks up values in the content of evaluation.json."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid.evaluation.equal_time import TOLERANCE
from hybrid.evaluation.keys import EQUAL_TIME, OURS_KEY, Key, half_name
from hybrid.measure.quality import METRICS

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
