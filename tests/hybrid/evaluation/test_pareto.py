"""The Pareto front of time and quality."""

from __future__ import annotations

from itertools import permutations

import pytest

from hybrid.evaluation.measured_settings import pareto_front
from tests import small


def front(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return pareto_front(points, lambda point: point)


def test_what_is_slower_and_worse_is_left_out():
    #           fast, poor  slower, better  slower, worse  slowest, best
    points = [(50.0, 8.0), (100.0, 9.0), (120.0, 8.9), (400.0, 9.6)]
    for shuffled in permutations(points):
        assert front(list(shuffled)) == [(50, 8), (100, 9), (400, 9.6)]


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([], []),
        ([(1, 1)], [(1, 1)]),
        # Equally good but slower; equally fast but worse.
        ([(2, 5), (1, 5)], [(1, 5)]),
        ([(1, 4), (1, 5)], [(1, 5)]),
        ([(1, 5), (2, 4), (3, 3)], [(1, 5)]),
        ([(1, -3), (2, -2)], [(1, -3), (2, -2)]),
    ],
)
def test_ties_and_ends(points, expected):
    assert front(points) == expected


def test_of_equal_items_the_first_one_stays():
    items = [("a", 1, 5), ("b", 1, 5)]
    assert pareto_front(items, lambda item: item[1:]) == [("a", 1, 5)]


def test_every_item_that_is_left_out_is_beaten_and_none_of_the_front_is():
    points = [(float(t), float(q)) for t, q in small.rng().integers(0, 20, (200, 2))]
    found = front(points)

    def beaten(point: tuple[float, float]) -> bool:
        return any(t <= point[0] and q >= point[1] and (t, q) != point for t, q in points)

    assert not any(beaten(point) for point in found)
    assert all(beaten(point) for point in points if point not in found)
    times, qualities = zip(*found, strict=True)
    assert list(times) == sorted(set(times))
    assert list(qualities) == sorted(set(qualities))
