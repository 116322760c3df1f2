"""Frozen functions whose recordings differ by the widths of arguments, and sizes that keep those few."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import pytest

from compose.base.arrays import uploaded
from compose.base.frozen import Frozen, capacity


@dataclass(frozen=True)
class Pair:
    one: Any
    other: Any


def reversed_pair(calls: list[int], pair: Pair) -> Pair:
    """Both arrays back to front, in memory of its own; what is called appends to `calls`."""
    calls.append(dr.width(pair.one))
    kind, found = type(pair.one), []
    for values in (pair.one, pair.other):
        count = dr.width(values)
        target, lane = dr.empty(kind, count), dr.arange(dr.uint32_array_t(kind), count)
        dr.scatter(target, values, count - 1 - lane)
        found.append(target)
    return Pair(*found)


def test_arguments_of_other_widths_are_recorded_anew(arrays):
    calls: list[int] = []
    function = Frozen(lambda pair: reversed_pair(calls, pair), by_size=True)
    for one, other in ((5, 5), (5, 9), (5, 5), (8, 9), (5, 9), (8, 9)):
        rows = [np.arange(width, dtype=np.float32) + width for width in (one, other)]
        found = function(Pair(*(uploaded(arrays.plain.Float, row) for row in rows)))
        np.testing.assert_array_equal(found.one.numpy(), rows[0][::-1])
        np.testing.assert_array_equal(found.other.numpy(), rows[1][::-1])
    assert calls == [5, 5, 8]


@pytest.mark.parametrize("kind", [int, bool, str, float])
def test_values_that_occur_again_are_told_apart(arrays, kind):
    """Dr.Jit alone replays (1, 0, 1) for (1, 0, 0), and the other way round."""
    zero, one = kind(0), kind(1)
    function = Frozen(lambda numbers, *values: numbers + values.count(one))
    number = arrays.plain.Float(0.0, 1.0)
    for values in ((one, zero, one), (one, zero, zero), (zero, one, zero), (zero, one, one)):
        assert function(number, *values).numpy().tolist() == [values.count(one), values.count(one) + 1]


@pytest.mark.parametrize("count", [0, 1, 1024, 1025, 5000, 123_457, (1 << 24) + 1])
def test_capacities_are_hardly_larger_than_what_they_are_for(count):
    found = capacity(count)
    assert found % 16 == 0
    assert max(count, 1024) <= found <= max(1.19 * count + 16, 1024)


def test_capacities_are_few():
    assert len({capacity(count) for count in range(1024, 1 << 14)}) <= 4 * 4 + 1
