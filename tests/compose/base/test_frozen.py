"""Frozen functions: recordings by widths of arguments, sizes that keep those few, the collector's pauses."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import numpy as np
import pytest

from compose.base.arrays import uploaded
from compose.base.frozen import Frozen, capacity, collector_paused


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


def test_sums_are_right_whatever_the_number_of_threads(arrays, threads):
    def total(values: Any) -> Any:
        sums = dr.zeros(type(values), 1)
        dr.scatter_reduce(dr.ReduceOp.Add, sums, values, arrays.plain.UInt(0))
        return sums

    function, count = Frozen(total), 1 << 20
    values = dr.full(arrays.plain.Float, 1, count)
    dr.make_opaque(values)
    for number in (1, 4, 1, 3):
        threads(number)
        assert [function(values)[0] for _ in range(8)] == [count] * 8


def test_ctrl_c_while_arguments_are_read_stays_what_it_is(arrays):
    class Interrupting:
        DRJIT_STRUCT: ClassVar = {"values": arrays.plain.Float}

        @property
        def values(self) -> None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Frozen(lambda given, values: values + 1)(Interrupting(), arrays.plain.Float(1))


def test_plain_values_that_repeat_earlier_ones_tell_recordings_apart(arrays):
    """Dr.Jit alone takes the third value for the same in all of these, as it occurred before."""

    def scaled(values: Any, one: Any, other: Any, chosen: Any) -> Any:
        return values * (2 if chosen == one else 3)

    function = Frozen(scaled)
    for one, other in ((True, False), (5, 6), ("a", "b"), (0.5, 0.25)):
        for chosen, factor in ((one, 2), (other, 3), (one, 2)):
            found = function(uploaded(arrays.plain.Float, np.ones(3, dtype=np.float32)), one, other, chosen)
            np.testing.assert_array_equal(found.numpy(), factor)


@pytest.mark.parametrize("count", [0, 1, 1024, 1025, 5000, 123_457, (1 << 24) + 1])
def test_capacities_are_hardly_larger_than_what_they_are_for(count):
    found = capacity(count)
    assert found % 16 == 0
    assert max(count, 1024) <= found <= max(1.19 * count + 16, 1024)


def test_capacities_are_few():
    assert len({capacity(count) for count in range(1024, 1 << 14)}) <= 4 * 4 + 1


@pytest.fixture(autouse=True)
def collector() -> Iterator[None]:
    """Whatever a test does, the collector runs afterwards."""
    gc.enable()
    yield
    gc.enable()


def test_the_collector_is_paused_inside():
    with collector_paused():
        assert not gc.isenabled()
    assert gc.isenabled()


def test_it_runs_again_after_an_error():
    with pytest.raises(ValueError, match="inside"), collector_paused():
        raise ValueError("inside")
    assert gc.isenabled()


def test_it_stays_off_where_it_was_off():
    gc.disable()
    with collector_paused():
        pass
    assert not gc.isenabled()


def test_pauses_overlap_in_any_order():
    """As those of two threads do."""
    one, other = collector_paused(), collector_paused()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert not gc.isenabled()
    other.__exit__(None, None, None)
    assert gc.isenabled()
