"""Hash tables against a dictionary."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.cells import Table, find
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def names(count: int, firsts: int) -> tuple[np.ndarray, np.ndarray]:
    """Names of cells of which many share the first one."""
    random = small.rng()
    second = random.choice(1 << 20, count, replace=False).astype(np.uint32) | np.uint32(1 << 21)
    return random.integers(0, firsts, count).astype(np.uint32) << np.uint32(7), second


def table_of(first: np.ndarray, second: np.ndarray) -> Table:
    return Table(first.astype(np.uint64) << np.uint64(32) | second)


@pytest.mark.parametrize(("count", "firsts"), [(1, 1), (4, 1), (1000, 1 << 20), (3000, 8000)])
def test_every_cell_is_found_and_no_other(count, firsts):
    first, second = names(count, firsts)
    table = table_of(first, second)
    known, index = find(table.arrays, mi.UInt32(first), mi.UInt32(second), mi.Bool(True))
    assert known.numpy().all()
    assert (index.numpy() == np.arange(count)).all()
    known, index = find(table.arrays, mi.UInt32(first), mi.UInt32(second + np.uint32(1 << 22)), mi.Bool(True))
    assert not known.numpy().any()
    assert (index.numpy() == 0).all()


def test_what_is_not_active_finds_nothing():
    first, second = names(100, 1000)
    active = np.arange(100) % 2 == 0
    known, _ = find(table_of(first, second).arrays, mi.UInt32(first), mi.UInt32(second), mi.Bool(active))
    assert (known.numpy() == active).all()


def test_an_empty_table_has_nothing():
    nothing = np.zeros(0, dtype=np.uint32)
    known, _ = find(table_of(nothing, nothing).arrays, mi.UInt32([0, 5]), mi.UInt32([1, 7]), mi.Bool(True))
    assert not known.numpy().any()
