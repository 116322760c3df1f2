"""Lists of splats per tile against a search over all pairs."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from splat.raster.binning import MINIMUM_ALPHA, Bins, TileBounds, depth_order
from splat.raster.tiles import TileGrid
from tests.splat.raster.splats import bin_splats, doubles, exponent, of_inverse, random_splats, round_splats

GRID = TileGrid(90, 70)


def lists(bins: Bins) -> dict[int, list[int]]:
    """The splats of each tile that has any, in order."""
    # The last range holds the pairs that no tile blends.
    (start, end), splat = bins.lists.ranges.numpy().reshape(-1, 2)[:-1].T, bins.lists.splat.numpy()
    return {t: splat[s:e].tolist() for t, (s, e) in enumerate(zip(start, end, strict=True)) if e > s}


def peaks(splats, grid: TileGrid, steps: int) -> np.ndarray:
    """(tiles, N) largest alpha of each splat over points between each tile's outermost pixel centres."""
    s = doubles(splats)
    found = np.zeros((grid.rows * grid.columns, len(s["x"])))
    # All pixel centres for steps == side, and points between them for more.
    offset = np.linspace(0.5, grid.side - 0.5, steps)
    for tile in range(len(found)):
        row, column = divmod(tile, grid.columns)
        px, py = np.meshgrid(column * grid.side + offset, row * grid.side + offset)
        dx, dy = px.ravel()[:, None] - s["x"], py.ravel()[:, None] - s["y"]
        found[tile] = (s["opacity"] * np.exp(-exponent(s, dx, dy) / 2)).max(axis=0)
    return found


@pytest.mark.parametrize("side", [8, 16])
def test_every_visible_pair_is_listed_and_hardly_any_other(arrays, side):
    grid = TileGrid(90, 70, side)
    splats = random_splats(arrays, 300, 90, 70)
    bins = bin_splats(arrays, splats, grid)
    listed = np.zeros((grid.rows * grid.columns, 300), dtype=bool)
    for tile, members in lists(bins).items():
        assert len(set(members)) == len(members)
        listed[tile, members] = True
    at_pixels = peaks(splats, grid, side) >= MINIMUM_ALPHA
    assert listed[at_pixels].all()
    assert at_pixels.sum() > 500
    # Whatever is listed is visible somewhere between the pixels, sampled four times as finely, with slack.
    between = peaks(splats, grid, 4 * side) >= 0.93 * MINIMUM_ALPHA
    assert between[listed].all()
    assert bins.pairs == listed.sum()


def test_lists_are_sorted_from_near_to_far(arrays):
    splats = random_splats(arrays, 300, 90, 70)
    depth = splats.depth.numpy()
    found = lists(bin_splats(arrays, splats, GRID))
    assert len(found) == GRID.rows * GRID.columns
    for members in found.values():
        assert (np.diff(depth[members]) >= 0).all()


def test_splats_that_are_in_order_keep_it(arrays):
    """The depths say the opposite and are not looked at."""
    rows = [(20.0, 20.0, 3.0, 0.5, 1, 1, 1, depth) for depth in (9.0, 5.0, 1.0)]
    splats = round_splats(arrays, rows)
    assert set(map(tuple, lists(bin_splats(arrays, splats, GRID, in_order=True)).values())) == {(0, 1, 2)}
    assert set(map(tuple, lists(bin_splats(arrays, splats, GRID)).values())) == {(2, 1, 0)}


def test_only_wanted_tiles_have_lists(arrays):
    splats = random_splats(arrays, 300, 90, 70)
    wanted = np.zeros((GRID.rows, GRID.columns), dtype=bool)
    wanted[1:3, 2:5] = True
    every, some = lists(bin_splats(arrays, splats, GRID)), lists(bin_splats(arrays, splats, GRID, wanted))
    assert some.keys() == set(np.flatnonzero(wanted))
    for tile, members in some.items():
        assert members == every[tile]
    assert bin_splats(arrays, splats, GRID, wanted).tiles.numpy().tolist() == np.flatnonzero(wanted).tolist()


def test_splats_stay_in_their_bounds(arrays):
    """Left part of the upper rows, and all of row 3 alone."""
    splats = random_splats(arrays, 200, 90, 70)
    upper = np.arange(200) % 2 == 0
    UInt = arrays.plain.UInt
    number = lambda a, b: UInt(np.where(upper, a, b).astype(np.uint32))  # noqa: E731
    bounds = TileBounds(number(2, 6), number(0, 3), number(3, 4))
    every, confined = (
        lists(bin_splats(arrays, splats, GRID)),
        lists(bin_splats(arrays, splats, GRID, None, bounds)),
    )
    for tile, members in every.items():
        row, column = divmod(tile, GRID.columns)
        inside = np.where(upper[members], (column < 2) & (row < 3), row == 3)
        assert confined.get(tile, []) == np.array(members)[inside].tolist()


def test_runs_name_the_pairs_of_each_splat(arrays):
    """The gradient sums a splat's pairs by them: each pair lies in the run of its splat."""
    splats = random_splats(arrays, 300, 90, 70)
    bins = bin_splats(arrays, splats, GRID)
    owner, first, count = (array.numpy() for array in (bins.owner, bins.first, bins.count))
    assert len(set(owner.tolist())) == len(owner)
    run_of = np.full(first[-1] + count[-1], -1)
    for o, f, c in zip(owner, first, count, strict=True):
        assert (run_of[f : f + c] == -1).all()
        run_of[f : f + c] = o
    unsorted, splat = bins.lists.unsorted.numpy(), bins.lists.splat.numpy()
    assert sorted(unsorted.tolist()) == list(range(len(unsorted)))
    # Behind the candidates, nothing is blended.
    assert (unsorted[: bins.pairs] < len(run_of)).all()
    np.testing.assert_array_equal(run_of[unsorted[: bins.pairs]], splat[: bins.pairs])


@pytest.mark.parametrize(
    "row",
    [
        (20.0, 20.0, 1.0, 0.9 * MINIMUM_ALPHA, 1, 1, 1, 1.0),
        (20.0, 20.0, 1.0, 0.0, 1, 1, 1, 1.0),
        (-50.0, 20.0, 2.0, 1.0, 1, 1, 1, 1.0),
        (20.0, 500.0, 2.0, 1.0, 1, 1, 1, 1.0),
        (float("nan"), 20.0, 1.0, 1.0, 1, 1, 1, 1.0),
        (20.0, 20.0, float("nan"), 1.0, 1, 1, 1, 1.0),
    ],
)
def test_invisible_splats_give_no_pairs(arrays, row):
    for in_order in (False, True):
        bins = bin_splats(arrays, round_splats(arrays, [row]), GRID, in_order=in_order)
        assert bins.pairs == 0
        assert lists(bins) == {}


def test_a_long_diagonal_splat_skips_the_corners_of_its_box(arrays):
    """Standard deviations 20 along the diagonal and 1 across it."""
    a, b = 1 / 20**2, 1.0
    xx, xy = (a + b) / 2, (a - b) / 2
    row = [45.0], [35.0], [xx], [xy], [xx], [1.0], [1.0], [1.0], [1.0], [1.0]
    found = lists(bin_splats(arrays, of_inverse(arrays, list(row)), GRID)).keys()
    # From the top left to the bottom right; tile (0, 4) and tile (4, 0) are in the box.
    assert {0, 7, 8, 14} <= found
    assert not {4, 5, 24} & found


def test_nothing_wanted_gives_empty_lists(arrays):
    splats = random_splats(arrays, 10, 90, 70)
    bins = bin_splats(arrays, splats, GRID, np.zeros((GRID.rows, GRID.columns), dtype=bool))
    assert bins.pairs == 0
    start, end = bins.lists.ranges.numpy().reshape(-1, 2).T
    assert (start == end).all()
    assert len(start) == GRID.rows * GRID.columns + 1


def test_depth_order_puts_the_near_first_and_the_unseen_last(arrays):
    depth = arrays.plain.Float([5.0, 0.5, 1e6, 3.0, 0.02, 4.0])
    seen = arrays.plain.Bool([True, True, True, False, True, True])
    assert depth_order(arrays, depth, seen).numpy().tolist() == [4, 1, 5, 0, 2, 3]


def test_depths_closer_than_one_part_in_100_000_keep_their_order(arrays):
    depth = np.linspace(2, 2 * (1 + 5e-6), 9)[::-1].astype(np.float32)
    everything = arrays.plain.Bool(True)
    # In one step of the sort or in two neighbouring ones, never reversed one by one.
    order = depth_order(arrays, arrays.plain.Float(depth), everything).numpy()
    assert (np.diff(order) < 0).sum() <= 1
    apart = arrays.plain.Float([2 * (1 + 2e-5), 2.0])
    assert depth_order(arrays, apart, everything).numpy().tolist() == [1, 0]
    assert dr.width(depth_order(arrays, apart, everything)) == 2


def test_depths_beyond_32_octaves_are_told_apart(arrays):
    """One part in 16,000, up to the largest float."""
    depth = np.float32([3e38, 1e8, 1.0001e8, 0.02, 1e20, 5e7, 0.99e8])
    order = depth_order(arrays, arrays.plain.Float(depth), arrays.plain.Bool(True))
    assert order.numpy().tolist() == [3, 5, 6, 1, 2, 4, 0]
    # What is not seen has no say in the steps.
    near = arrays.plain.Float([2 * (1 + 2e-5), 2.0, 3e38, float("nan")])
    seen = arrays.plain.Bool([True, True, False, False])
    assert depth_order(arrays, near, seen).numpy().tolist() == [1, 0, 2, 3]
