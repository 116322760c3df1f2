"""Cells: their names, no two with the same, none that something divides; their tables."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.cells import _FACTORS, SIDES, Cells, Grid, Points, Table, find
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
GRID = Grid(np.zeros(3, dtype=np.float32), 1.0)


def always(one, other, side) -> np.ndarray:
    return np.ones(len(one), dtype=bool)


def points(count: int, spread: float = 1.0) -> Points:
    random = small.rng()
    normal = random.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    position = random.uniform(-spread, spread, (count, 3))
    return Points(position.astype(np.float32), normal.astype(np.float32))


def mixed(parts, factors) -> int:
    """The finalizer of MurmurHash3 of a sum of products, in Python's own numbers."""
    bits = sum(int(part) * factor for part, factor in zip(parts, factors, strict=True)) & 0xFFFFFFFF
    bits = (bits ^ bits >> 16) * 0x85EBCA6B & 0xFFFFFFFF
    bits = (bits ^ bits >> 13) * 0xC2B2AE35 & 0xFFFFFFFF
    return bits ^ bits >> 16


def plain_key(position, normal, level: int) -> int:
    place = np.floor(position / np.float32(SIDES[level])).astype(int)
    axis = int(np.abs(normal).argmax())
    kind = 2 * axis + (normal[axis] > 0) + 8 * level
    first, second = (mixed((*place, kind), factors) for factors in _FACTORS)
    return first << 32 | second | 1


@pytest.mark.parametrize("level", range(len(SIDES)))
def test_names_are_those_of_integers_of_any_size(level):
    some = points(500, 30)
    expected = [plain_key(p, n, level) for p, n in zip(some.position, some.normal, strict=True)]
    assert GRID.keys(some, level).tolist() == expected


def test_names_are_relative_to_the_grid():
    """To half a cell, as rounding may move what lies at a border."""
    some, side = points(500), SIDES[1]
    position = (np.floor(some.position / side) + 0.5) * side
    grid = Grid(np.float32([5, -3, 0.25]), 2.5)
    moved = Points((2.5 * position + grid.origin).astype(np.float32), some.normal)
    own = Points(position.astype(np.float32), some.normal)
    np.testing.assert_array_equal(grid.keys(moved, 1), GRID.keys(own, 1))


def test_names_of_normals_along_axes():
    normal = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 0], [0, 1, 1], [1, 0, 1]] / np.sqrt(2)])
    some = Points(np.full((9, 3), 0.1, dtype=np.float32), normal.astype(np.float32))
    keys = GRID.keys(some, 0)
    assert keys.tolist() == [plain_key(p, n, 0) for p, n in zip(some.position, some.normal, strict=True)]
    assert len(np.unique(keys[:6])) == 6


def test_cells_of_a_block_all_have_names_of_their_own():
    """A hash of coordinates joined by exclusive or gives places on one wall the names of another."""
    side = np.float32(SIDES[0])
    index = np.stack(np.meshgrid(*[np.arange(-32, 32)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    position = ((index + 0.5) * side).astype(np.float32)
    keys = [
        GRID.keys(Points(position, np.tile(np.float32(normal), (len(position), 1))), 0)
        for normal in np.concatenate([np.eye(3), -np.eye(3)])
    ]
    assert len(np.unique(np.concatenate(keys))) == 6 * 64**3


def test_points_lie_in_the_cells_that_they_make():
    some = points(300)
    cells = Cells.of(some, GRID, always)
    indices = cells.indices(some)
    assert (indices >= 0).all()
    for level in range(len(SIDES)):
        _, count = np.unique(indices[level], return_counts=True)
        assert sorted(count) == sorted(cells.counts[level])
    assert (cells.indices(Points(some.position + 1000, some.normal)) == -1).all()


def test_a_cell_that_something_divides_is_left_out():
    floor = np.tile(np.float32([0, 1, 0]), (200, 1))
    position = small.rng(3).uniform(0.001, SIDES[0] - 0.001, (200, 3)).astype(np.float32)
    position[100:, 0] += np.float32(2 * SIDES[0])
    wall = SIDES[0] / 2

    def joined(one, other, side):
        return (position[one, 0] < wall) == (position[other, 0] < wall)

    cells = Cells.of(Points(position, floor), GRID, joined)
    indices = cells.indices(Points(position, floor))
    assert (indices[0, :100] == -1).all()
    assert (indices[0, 100:] >= 0).all()
    assert (indices[1:] == -1).all()


def test_the_smallest_cell_is_found_however_few_points_it_has():
    normal = np.float32([[0, 1, 0]])
    dense, rare = np.full((8, 3), 0.001, dtype=np.float32), np.full((1, 3), 0.03, dtype=np.float32)
    some = Points(np.concatenate([dense, rare]), np.repeat(normal, 9, axis=0))
    cells = Cells.of(some, GRID, always)
    np.testing.assert_array_equal(cells.smallest(some), cells.indices(some)[0])
    lonely = Points(np.full((1, 3), 5, dtype=np.float32), normal)
    every = Cells.of(
        Points(np.concatenate([some.position, lonely.position]), np.repeat(normal, 10, axis=0)), GRID, always
    )
    assert every.smallest(lonely) == every.indices(lonely)[0]
    # A cell of the next level contains another point, in a small cell that has none.
    near = Points(np.full((1, 3), 0.05, dtype=np.float32), normal)
    assert cells.indices(near)[0] == -1
    assert cells.smallest(near) == cells.indices(near)[1] >= 0
    assert every.smallest(Points(np.full((1, 3), -9, dtype=np.float32), normal)) == -1
    assert len(cells.only_known()) == 2
    assert cells.only_known().known.all()


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
