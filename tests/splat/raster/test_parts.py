"""Frames in parts: the same bits as in one pass, whatever the bound on pairs."""

from __future__ import annotations

import numpy as np
import pytest

from splat.raster import parts as parts_module
from splat.raster.binning import TileBounds
from splat.raster.blending import gradients_from_sums
from splat.raster.parts import Parts, rasterize_parts, sums_of_parts
from splat.raster.tiles import TileGrid
from tests.extremes import extreme
from tests.splat.raster.splats import (
    bin_splats,
    candidates_of,
    random_splats,
    rasterize_backward,
    rasterized,
    round_splats,
)

GRID = TileGrid(90, 70)


@pytest.fixture
def at_once(monkeypatch):
    """Sets the bound on pairs."""
    return lambda pairs: monkeypatch.setattr(parts_module, "PAIRS_AT_ONCE", pairs)


def flow(arrays):
    count = GRID.padded_width * GRID.padded_height * 4
    return arrays.plain.Float(np.random.default_rng(5).normal(size=count).astype(np.float32))


@pytest.mark.parametrize(
    "pairs",
    [
        pytest.param(
            pairs,
            marks=extreme(
                f"at most {pairs} pairs at once",
                given="a frame of 1,500 pairs",
                expected="image and gradients with the bits of one pass",
            ),
        )
        for pairs in (1000, 150, 1)
    ],
)
def test_parts_have_the_bits_of_one_pass(each_arrays, got, at_once, pairs):
    splats, gradient = random_splats(each_arrays, 300, 90, 70), flow(each_arrays)
    bins = bin_splats(each_arrays, splats, GRID)
    (image,) = rasterized(each_arrays, splats, bins)
    expected = rasterize_backward(each_arrays, splats, bins, image, gradient)
    at_once(pairs)
    parts = Parts(candidates_of(each_arrays, splats, GRID))
    # A single row of tiles has more than 150 of them, a single tile more than one.
    assert got(len(list(parts))) >= {1000: 2, 150: 8, 1: GRID.rows * GRID.columns}[pairs]
    np.testing.assert_array_equal(rasterize_parts(each_arrays, parts)[0].numpy(), image.numpy())
    found = gradients_from_sums(splats, sums_of_parts(each_arrays, parts, image, gradient))
    for part, whole in zip(found, expected, strict=True):
        np.testing.assert_array_equal(part.numpy(), whole.numpy())


def test_parts_follow_one_another_and_are_small(each_arrays, at_once):
    at_once(100)
    splats = random_splats(each_arrays, 300, 90, 70)
    every = bin_splats(each_arrays, splats, GRID)
    lists = list(Parts(candidates_of(each_arrays, splats, GRID)))
    tiles = np.concatenate([bins.tiles.numpy() for bins in lists])
    np.testing.assert_array_equal(tiles, np.arange(GRID.rows * GRID.columns))
    assert sum(bins.pairs for bins in lists) == every.pairs
    # Each list is kept to the bound, but that of a single tile.
    assert all(bins.count.numpy().sum() <= 100 or len(bins.tiles.numpy()) == 1 for bins in lists)


def test_wanted_tiles_and_bounds_hold_in_parts(each_arrays, at_once):
    splats = random_splats(each_arrays, 300, 90, 70)
    wanted = np.random.default_rng(0).random((GRID.rows, GRID.columns)) < 0.5
    UInt = each_arrays.plain.UInt
    bounds = TileBounds(UInt([4]), UInt([1]), UInt([4]))
    (whole,) = rasterized(
        each_arrays, splats, bin_splats(each_arrays, splats, GRID, wanted, bounds, in_order=True)
    )
    at_once(40)
    parts = Parts(candidates_of(each_arrays, splats, GRID, wanted, bounds, in_order=True))
    assert len(list(parts)) > 3
    np.testing.assert_array_equal(rasterize_parts(each_arrays, parts)[0].numpy(), whole.numpy())
    assert whole.numpy().any()


def test_nothing_to_draw_is_black(each_arrays, at_once):
    at_once(0)
    splats = round_splats(each_arrays, [(8.0, 8.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0)])
    parts = Parts(candidates_of(each_arrays, splats, GRID))
    (image,) = rasterize_parts(each_arrays, parts)
    assert not image.numpy().any()
    gradients = gradients_from_sums(splats, sums_of_parts(each_arrays, parts, image, flow(each_arrays)))
    assert not any(gradient.numpy().any() for gradient in gradients)


@extreme(
    "4,613,734,400 pairs",
    given="2,200 splats over a frame of 32,768 x 16,384",
    expected="counted beyond 32 bits, in parts of at most a million",
)
def test_more_pairs_than_32_bits_are_counted(each_arrays, got, at_once):
    at_once(1_000_000)
    grid = TileGrid(32_768, 16_384)
    splats = round_splats(each_arrays, [(16_384.0, 8_192.0, 1e5, 0.9, 1.0, 1.0, 1.0, 1.0)] * 2200)
    candidates = candidates_of(each_arrays, splats, grid)
    assert got(candidates.runs(candidates.whole).pairs) == 2200 * 2048 * 1024 > 2**32
    first = next(iter(Parts(candidates_of(each_arrays, splats, grid))))
    assert got(first.pairs) <= 1_000_000
    assert first.pairs == 2200 * len(first.tiles.numpy())
