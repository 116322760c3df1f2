"""Blocks of pixels: where they lie, what they read, and the exponential they use."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from splat.raster.binning import MINIMUM_ALPHA
from splat.raster.blocks import (
    CHANNELS,
    MINIMUM_TRANSMITTANCE,
    PIXEL,
    Blocks,
    Shown,
    _shown_in,
    exp2,
    records_of_pairs,
)
from splat.raster.tiles import TileGrid
from tests.splat.raster.splats import bin_splats, blended_records, doubles, exponent, random_splats


def blocks_of(arrays, side: int, wanted: np.ndarray | None = None):
    grid = TileGrid(90, 70, side)
    splats = random_splats(arrays, 100, 90, 70)
    bins = bin_splats(arrays, splats, grid, wanted)
    given = None if wanted is None else bins.tiles
    return Blocks.of_tiles(arrays, bins.lists, dr.width(bins.tiles), given), bins, splats


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
    loaded = block.loaded(arrays.plain.Float(image), width, 3)
    shaped = image.reshape(height, width, CHANNELS)
    x, y = block.x.numpy(), block.y.numpy()
    for pixel in range(block.pixels):
        row, column = divmod(pixel, block.side)
        for channel in range(3):
            found = loaded[pixel][channel].numpy()
            np.testing.assert_array_equal(found, shaped[y + row, x + column, channel])
    assert [len(channels) for channels in loaded] == [3] * block.pixels
    assert [first for _, first in block.chunks(width)] == list(range(0, block.pixels, 2))


def test_lanes_walk_the_list_of_their_tile(arrays):
    block, bins, _ = blocks_of(arrays, 16)
    tile = (block.y.numpy() // 16) * bins.grid.columns + block.x.numpy() // 16
    ranges = np.stack([block.first.numpy(), block.last.numpy()], axis=1)
    np.testing.assert_array_equal(ranges, bins.lists.ranges.numpy().reshape(-1, 2)[tile])


@pytest.mark.parametrize("side", [8, 16])
def test_alphas_are_those_of_the_ellipse(arrays, side):
    """2^(log2 alpha) is opacity exp(-q / 2) at each pixel centre, for the first splat of each list."""
    block, bins, splats = blocks_of(arrays, side)
    first = block.first.numpy()
    record = records_of_pairs(blended_records(arrays, splats), bins.lists).at(block.first)
    s = {name: row[bins.lists.splat.numpy()[first]] for name, row in doubles(splats).items()}
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
    record = records_of_pairs(blended_records(arrays, splats), bins.lists).at(
        dr.arange(arrays.plain.UInt, bins.pairs)
    )
    order = bins.lists.splat.numpy()[: bins.pairs]
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


@pytest.mark.parametrize("side", [8, 16])
def test_blocks_show_a_splat_where_a_pixel_does(arrays, side):
    """No block is missed, and few are there in vain."""
    grid = TileGrid(90, 70, side)
    splats = random_splats(arrays, 300, 90, 70)
    bins = bin_splats(arrays, splats, grid)
    found = _shown_in(
        arrays, bins.lists, records_of_pairs(blended_records(arrays, splats), bins.lists)
    ).numpy()
    (start, end), splat = bins.lists.ranges.numpy().reshape(-1, 2).T, bins.lists.splat.numpy()
    values, seen, drawn, in_vain = doubles(splats), 0, 0, 0
    for tile in range(grid.columns * grid.rows):
        x, y = (np.arange(side) + 0.5 + side * k for k in (tile % grid.columns, tile // grid.columns))
        for pair in range(start[tile], end[tile]):
            own = {name: row[splat[pair]] for name, row in values.items()}
            dy = y[:, None] - own["y"]
            t = x - own["x"] + own["shear"] * dy
            power = -0.5 * (own["x_precision"] * t**2 + own["y_precision"] * dy**2)
            visible = own["opacity"] * np.exp(power) >= MINIMUM_ALPHA
            blocks = visible.reshape(4, side // 4, 4, side // 4).any(axis=(1, 3)).ravel()
            bits = found[pair] >> np.arange(16) & 1 == 1
            assert not (blocks & ~bits).any()
            seen, drawn, in_vain = seen + 16, drawn + blocks.sum(), in_vain + (bits & ~blocks).sum()
    assert 0 < drawn < seen
    assert in_vain < 0.05 * seen


@pytest.mark.parametrize("side", [8, 16])
def test_lanes_jump_to_what_their_block_shows(arrays, side):
    block, bins, splats = blocks_of(arrays, side)
    records = records_of_pairs(blended_records(arrays, splats), bins.lists)
    bits = _shown_in(arrays, bins.lists, records).numpy()
    first, last, number = (row.numpy() for row in (block.first, block.last, block.number))
    # From each end of a list, and from one in its midst.
    for start in (first, (first + last) // 2, last):
        found = Shown(arrays, bins.lists, records).following(
            arrays.plain.UInt(start), block.last, block.number
        )
        for lane, pair in enumerate(found.numpy()):
            shown = start[lane] + np.flatnonzero(bits[start[lane] : last[lane]] >> number[lane] & 1)
            assert pair == shown[0] if len(shown) else pair >= last[lane]
