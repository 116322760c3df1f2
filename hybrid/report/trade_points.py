"""The trade of time against quality: every configuration a point, and those that none other beats."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hybrid.evaluation.verdicts import keys_of, mean_of
from hybrid.measure.quality import METRICS
from hybrid.plan.pareto import pareto_front


@dataclass(frozen=True)
class Point:
    """One configuration: its median time and the mean of a metric over the views."""

    method: str
    budget: str
    milliseconds: float
    value: float


def points_of(found: dict[str, Any], region: str, metric: str) -> list[Point]:
    """All configurations of an evaluation that were timed and judged."""
    times = {(row["method"], row["budget"]): row["ms"]["p50"] for row in found["time"]}
    points = []
    for key in keys_of(found):
        value = mean_of(found, key, region, metric)
        if value is not None and key in times:
            points.append(Point(*key, times[key], value))
    return points


def frontier(points: list[Point], metric: str) -> list[Point]:
    """The points that no other is both faster and better than, from the fastest to the best."""
    sign = 1 if METRICS[metric] else -1
    return pareto_front(points, lambda point: (point.milliseconds, sign * point.value))
