"""Where a time lies among values at equal steps of it."""

from __future__ import annotations


def between_steps(time: float, count: int) -> tuple[int, float]:
    """Index of the value before a time from 0 to 1, and the share of the way from it to the next one.

    Args:
        time: 0 to 1.
        count: number of values, the first at time 0 and the last at 1; two or more.
    """
    at = time * (count - 1)
    first = min(int(at), count - 2)
    return first, at - first
