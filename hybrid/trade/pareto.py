"""The Pareto front of time and quality."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import TypeVar

T = TypeVar("T")


def pareto_front(items: Iterable[T], cost_and_quality: Callable[[T], tuple[float, float]]) -> list[T]:
    """The Pareto-optimal items, ordered from the fastest to the best.

    An item is left out if another one is at least as fast and at least as good; of equal items the first one
    stays. An item whose time or quality is NaN compares with none and is left out as well.

    Args:
        items: to choose from.
        cost_and_quality: returns the time of an item (less is better) and its quality (more is better).
    """
    front: list[T] = []
    known = [item for item in items if not any(math.isnan(value) for value in cost_and_quality(item))]
    for item in sorted(known, key=lambda one: (cost_and_quality(one)[0], -cost_and_quality(one)[1])):
        if not front or cost_and_quality(item)[1] > cost_and_quality(front[-1])[1]:
            front.append(item)
    return front
