"""Methods as points in the plane of time and quality, and their Pareto front."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hybrid.evaluation.keys import Key
from hybrid.evaluation.results import keys_of, mean_of, times_of
from hybrid.measure.quality import METRICS
from hybrid.trade.pareto import pareto_front


@dataclass(frozen=True)
class Point:
    """A method at one budget.

    Attributes:
        key: method and budget.
        milliseconds: median time of a frame.
        value: mean of a metric over the views.
    """

    key: Key
    milliseconds: float
    value: float


def points_of(found: dict[str, Any], region: str, metric: str) -> list[Point]:
    """All methods and budgets of an evaluation that were timed and whose metric was measured."""
    times = times_of(found)
    points = []
    for key in keys_of(found):
        value = mean_of(found, key, region, metric)
        if value is not None and key in times:
            points.append(Point(key, times[key], value))
    return points


def pareto_optimal(points: list[Point], metric: str) -> list[Point]:
    """The Pareto front: no other point is both faster and better. From the fastest to the best."""
    sign = 1 if METRICS[metric] else -1
    return pareto_front(points, lambda point: (point.milliseconds, sign * point.value))
