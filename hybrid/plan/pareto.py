"""The Pareto front of time and quality."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

T = TypeVar("T")


def pareto_front(items: Iterable[T], place: Callable[[T], tuple[float, float]]) -> list[T]:
    """Those that no other is both faster and better than, from the fastest to the best.

    Args:
        items: to choose among.
        place: of an item, its time and its quality, of which more is better.
    """
    best: list[T] = []
    for item in sorted(items, key=lambda one: (place(one)[0], -place(one)[1])):
        if not best or place(item)[1] > place(best[-1])[1]:
            best.append(item)
    return best
