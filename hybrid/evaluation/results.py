"""Looks up values in the content of evaluation.json."""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid.evaluation.equal_time import TOLERANCE
from hybrid.evaluation.keys import EQUAL_TIME, OURS_KEY, Key
from hybrid.measure.quality import METRICS

# Metrics that the fovea is compared by, and those used if neither is installed.
_FOVEAL, _FALLBACK = ("jod", "flip"), ("ssim", "psnr")


def keys_of(found: dict[str, Any]) -> list[Key]:
    """Methods and budgets, in the order in which they were measured."""
    return list(dict.fromkeys(Key(row["method"], row["budget"]) for row in found["methods"]))


def values_of(found: dict[str, Any], key: Key, region: str, metric: str) -> list[float]:
    """Values of a method and budget, one per view, in the order of views."""
    rows = [
        row
        for row in found["quality"]
        if (row["method"], row["budget"], row["region"], row["metric"]) == (*key, region, metric)
    ]
    return [row["value"] for row in sorted(rows, key=lambda row: row["view"])]


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
