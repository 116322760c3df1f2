"""The Pareto front of time and quality."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

T = TypeVar("T")


def pareto_front(items: Iterable[T], cost_and_quality: Callable[[T], tuple[float, float]]) -> list[T]:
    """The Pareto-optimal items: no other is both faster and better. From the fastest to the best.

    Args:
        items: to choose from.
        cost_and_quality: of an item, its time (less is better) and its quality (more is better).
    """
    front: list[T] = []
    for item in sorted(items, key=lambda one: (cost_and_quality(one)[0], -cost_and_quality(one)[1])):
        if not front or cost_and_quality(item)[1] > cost_and_quality(front[-1])[1]:
            front.append(item)
    return front
