"""Blending against values by hand and against the float64 twin."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splat.raster import blending
from splat.raster.blending import MAXIMUM_ALPHA
from splat.raster.blocks import CHANNELS
from splat.raster.tiles import TileGrid
from tests.splat.raster.splats import (
    bin_splats,
    blended,
    doubles,
    random_splats,
    rasterized,
    round_splats,
)

GRID = TileGrid(90, 70)


def image_of(arrays, splats, grid: TileGrid = GRID, wanted: np.ndarray | None = None) -> np.ndarray:
    """(padded H, padded W, 4)."""
    (buffer,) = rasterized(arrays, splats, bin_splats(arrays, splats, grid, wanted))
    return buffer.numpy().reshape(grid.padded_height, grid.padded_width, CHANNELS)


@pytest.mark.parametrize("side", [8, 16])
def test_an_image_equals_its_twin(arrays, side):
    splats = random_splats(arrays, 150, 90, 70)
    image = image_of(arrays, splats, TileGrid(90, 70, side))
    leaves = {name: torch.from_numpy(row) for name, row in doubles(splats).items()}
    expected = blended(leaves, 90, 70).numpy()
    # Worst seen 2e-4: blocks stop at a transmittance of 1e-4, and colours reach 2.
    np.testing.assert_allclose(image[:70, :90, :3], expected, atol=5e-4)


@pytest.mark.parametrize("heights", [[5], [2, 3], [1, 3, 1], [4, 1]])
def test_images_above_each_other_are_drawn_apart(arrays, heights):
    """Each its rows of tiles, to the bit; where nothing is wanted, they are black."""
    splats, wanted = random_splats(arrays, 150, 90, 70), np.ones((GRID.rows, GRID.columns), dtype=bool)
    wanted[2, 1:4] = False
    whole = image_of(arrays, splats, GRID, wanted)
    images = rasterized(arrays, splats, bin_splats(arrays, splats, GRID, wanted), heights)
    rows = [image.numpy().reshape(-1, GRID.padded_width, CHANNELS) for image in images]
    assert [len(part) for part in rows] == [height * GRID.side for height in heights]
    np.testing.assert_array_equal(np.concatenate(rows), whole)


def test_two_splats_blend_front_to_back(arrays):
    """At the common centre: 0.6 of red in front, 0.5 of green through the rest; then the other way around."""
    red, green = (10.5, 10.5, 4.0, 0.6, 1.0, 0.0, 0.0), (10.5, 10.5, 4.0, 0.5, 0.0, 2.0, 0.0)
    for near, far, expected in (
        (red, green, [0.6, 0.4 * 0.5 * 2, 0, 0.8]),
        (green, red, [0.5 * 0.6, 0.5 * 2, 0, 0.8]),
    ):
        image = image_of(arrays, round_splats(arrays, [(*far, 7.0), (*near, 3.0)]))
        np.testing.assert_allclose(image[10, 10], expected, rtol=1e-5)


def test_alpha_falls_as_a_gaussian_and_ends_at_one_part_in_255(arrays):
    """Standard deviation 3, opacity 0.5: sd sqrt(2 ln 127.5) = 9.34 px is where it reaches 1/255."""
    image = image_of(arrays, round_splats(arrays, [(20.5, 20.5, 3.0, 0.5, 1.0, 1.0, 1.0, 1.0)]))
    for offset, expected in (
        (0, 0.5),
        (3, 0.5 * np.exp(-0.5)),
        (6, 0.5 * np.exp(-2)),
        (9, 0.5 * np.exp(-4.5)),
    ):
        for x, y in ((20 + offset, 20), (20 - offset, 20), (20, 20 + offset), (20, 20 - offset)):
            assert image[y, x, 0] == pytest.approx(expected, rel=1e-5)
    assert image[20, 30].tolist() == [0, 0, 0, 0]


def test_alpha_is_at_most_99_percent(arrays):
    splats = round_splats(arrays, [(10.5, 10.5, 5.0, 1.0, 1.0, 1.0, 1.0, 1.0)])
    image = image_of(arrays, splats)
    assert MAXIMUM_ALPHA == 0.99
    np.testing.assert_allclose(image[10, 10], 0.99, rtol=1e-5)


def test_nothing_shines_through_three_opaque_splats(arrays):
    """The third one ends the block at a transmittance of 1e-6; a fourth adds nothing at all."""
    white = lambda depth, radiance: (10.5, 10.5, 50.0, 1.0, radiance, 0, 0, depth)  # noqa: E731
    three = [white(1.0, 1.0), white(2.0, 1.0), white(3.0, 1.0)]
    image = image_of(arrays, round_splats(arrays, three))
    behind = image_of(arrays, round_splats(arrays, [*three, white(4.0, 1e9)]))
    np.testing.assert_array_equal(image[10, 10], behind[10, 10])


def test_only_wanted_tiles_are_drawn(arrays):
    splats = random_splats(arrays, 150, 90, 70)
    wanted = np.zeros((GRID.rows, GRID.columns), dtype=bool)
    wanted[1, 1:4] = True
    whole, part = image_of(arrays, splats), image_of(arrays, splats, wanted=wanted)
    pixels = wanted.repeat(16, axis=0).repeat(16, axis=1)
    np.testing.assert_array_equal(part[pixels], whole[pixels])
    assert (part[~pixels] == 0).all()
    assert (whole[~pixels] != 0).any()


def test_an_empty_tile_is_black_and_transparent(arrays):
    """Also if all tiles are drawn, in memory that nobody cleared."""
    image = image_of(arrays, round_splats(arrays, [(8.0, 8.0, 1.0, 0.9, 1.0, 1.0, 1.0, 1.0)]))
    assert (image[32:] == 0).all()
    assert image[8, 8, 3] > 0.5


def test_no_splats_give_black(arrays):
    image = image_of(arrays, round_splats(arrays, [(8.0, 8.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0)]))
    assert image.shape == (80, 96, 4)
    assert (image == 0).all()


@pytest.mark.parametrize("side", [8, 16])
def test_lanes_that_stay_together_give_the_same(arrays, side, monkeypatch):
    """As on a GPU, and where lists are long: every lane visits all splats of its tile."""
    splats, grid = random_splats(arrays, 300, 90, 70), TileGrid(90, 70, side)
    wanted = np.random.default_rng(0).random((grid.rows, grid.columns)) < 0.6
    for tiles in (None, wanted):
        image = image_of(arrays, splats, grid, tiles)
        for name, other in (("stays_together", lambda arrays: True), ("_LONG_LIST", 0)):
            with monkeypatch.context() as patch:
                patch.setattr(blending, name, other)
                np.testing.assert_array_equal(image_of(arrays, splats, grid, tiles), image)
