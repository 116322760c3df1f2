"""Blocks of pixels: where they lie, what they read, and the exponential they use."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from splat.raster.binning import bin_splats
from splat.raster.blocks import CHANNELS, MINIMUM_TRANSMITTANCE, PIXEL, Blocks, blended_records, exp2
from splat.raster.tiles import TileGrid
from tests.splat.raster.splats import doubles, exponent, random_splats


def blocks_of(arrays, side: int, wanted: np.ndarray | None = None):
    grid = TileGrid(90, 70, side)
    splats = random_splats(arrays, 100, 90, 70)
    bins = bin_splats(arrays, splats, grid, wanted)
    return Blocks(arrays, bins), bins, splats


@pytest.mark.parametrize("side", [8, 16])
def test_blocks_tile_the_wanted_tiles(arrays, side):
    grid = TileGrid(90, 70, side)
    wanted = np.random.default_rng(0).random((grid.rows, grid.columns)) < 0.6
    block, _, _ = blocks_of(arrays, side, wanted)
    assert block.pixels == block.side**2 == (side // 4) ** 2
    hits = np.zeros((grid.padded_height, grid.padded_width), dtype=int)
    for x, y in zip(block.x.numpy(), block.y.numpy(), strict=True):
        hits[y : y + block.side, x : x + block.side] += 1
    np.testing.assert_array_equal(hits, wanted.repeat(side, axis=0).repeat(side, axis=1))


@pytest.mark.parametrize("side", [8, 16])
def test_chunks_address_each_pixel_once(arrays, side):
    """Two pixels at a time: a block reads back what lies at its pixels in an image."""
    block, bins, _ = blocks_of(arrays, side)
    width, height = bins.grid.padded_width, bins.grid.padded_height
    image = np.arange(width * height * CHANNELS, dtype=np.float32)
    loaded = [value.numpy() for value in block.loaded(arrays.plain.Float(image), width)]
    shaped = image.reshape(height, width, CHANNELS)
    x, y = block.x.numpy(), block.y.numpy()
    for pixel in range(block.pixels):
        row, column = divmod(pixel, block.side)
        for channel in range(3):
            np.testing.assert_array_equal(loaded[3 * pixel + channel], shaped[y + row, x + column, channel])
    assert len(loaded) == 3 * block.pixels
    assert [first for _, first in block.chunks(width)] == list(range(0, block.pixels, 2))


def test_lanes_walk_the_list_of_their_tile(arrays):
    block, bins, _ = blocks_of(arrays, 16)
    tile = (block.y.numpy() // 16) * bins.grid.columns + block.x.numpy() // 16
    np.testing.assert_array_equal(block.first.numpy(), bins.start.numpy()[tile])
    np.testing.assert_array_equal(block.last.numpy(), bins.end.numpy()[tile])


@pytest.mark.parametrize("side", [8, 16])
def test_alphas_are_those_of_the_ellipse(arrays, side):
    """2^(log2 alpha) is opacity exp(-q / 2) at each pixel centre, for the first splat of each list."""
    block, bins, splats = blocks_of(arrays, side)
    first = block.first.numpy()
    record = blended_records(arrays, splats, bins).at(block.first)
    s = {name: row[bins.splat.numpy()[first]] for name, row in doubles(splats).items()}
    for pixel, (power, u, v) in enumerate(block.log2_alphas(record)):
        row, column = divmod(pixel, block.side)
        dx, dy = block.x.numpy() + column + 0.5 - s["x"], block.y.numpy() + row + 0.5 - s["y"]
        t = dx + s["shear"] * dy
        np.testing.assert_allclose(u.numpy() / record.u_x.numpy(), t, atol=1e-4)
        np.testing.assert_allclose(v.numpy() / record.v_y.numpy(), dy, atol=1e-4)
        alpha = s["opacity"] * np.exp(-exponent(s, dx, dy) / 2)
        np.testing.assert_allclose(np.exp2(power.numpy().astype(np.float64)), alpha, rtol=1e-3, atol=1e-5)


def test_records_follow_the_lists(arrays):
    _, bins, splats = blocks_of(arrays, 16)
    record = blended_records(arrays, splats, bins).at(dr.arange(arrays.plain.UInt, bins.pairs))
    order = bins.splat.numpy()[: bins.pairs]
    for name in ("x", "y", "red", "green", "blue"):
        np.testing.assert_array_equal(getattr(record, name).numpy(), getattr(splats, name).numpy()[order])


def test_a_block_stops_at_the_end_or_when_all_its_pixels_are_opaque(arrays):
    block, _, _ = blocks_of(arrays, 8)
    dark, bright = arrays.plain.Float(0.99 * MINIMUM_TRANSMITTANCE), arrays.plain.Float(0.5)
    assert dr.all(block.is_active(block.last - 1, [dark, dark, bright, dark]))
    assert dr.none(block.is_active(block.last, [dark, dark, bright, dark]))
    assert dr.none(block.is_active(block.last - 1, [dark, dark, dark, dark]))


def test_exp2_is_accurate_where_alpha_is_visible(arrays):
    power = np.linspace(-15.9, 0, 100_001, dtype=np.float32)
    expected = np.exp2(power.astype(np.float64))
    # Worst seen 1.5e-7; a float's spacing is 1.2e-7.
    np.testing.assert_allclose(exp2(arrays, arrays.plain.Float(power)).numpy(), expected, rtol=3e-7)
    far = exp2(arrays, arrays.plain.Float([-16.0, -17.0, -1e30, -float("inf")])).numpy()
    np.testing.assert_allclose(far, 2.0**-16, rtol=1e-6)


def test_a_pixel_is_four_floats():
    assert sum(packet.size for packet in PIXEL.packets) == CHANNELS
    assert PIXEL.spare == 0
