"""Images and coarser ones of them on the device, against plain twins."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from compose.fusion.maps import Grid, among, block_means, box_mean, interpolated, pixels_of
from tests import small
from tests.compose.arrays_of import channels, floats, host, indices
from tests.compose.fusion import plain_fusion

SIZES = [(16, 24), (7, 9), (1, 5), (33, 70), (1, 1)]


def image(height: int, width: int, count: int = 2) -> np.ndarray:
    return small.rng(3).uniform(0, 1, (height, width, count)).astype(np.float32)


def of_pixels(found: list[object], height: int, width: int) -> np.ndarray:
    """(H, W, C) of what kernels say for the lanes of a grid."""
    return host(found)[: height * width].reshape(height, width, len(found))


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_lanes_have_the_pixels_in_order(arrays, height, width):
    grid = Grid.of(arrays, height, width)
    row, column, known = grid.pixels()
    rows, columns = np.divmod(np.arange(height * width), width)
    for found, expected in ((row, rows), (column, columns), (known, True)):
        np.testing.assert_array_equal(np.array(found)[: height * width], expected)
    assert not np.array(known)[height * width :].any()
    np.testing.assert_array_equal(np.array(grid.index(row, column))[: height * width], rows * width + columns)


def test_beyond_the_border_lies_what_is_at_the_border(arrays):
    grid = Grid.of(arrays, 3, 4)
    row, column = (arrays.plain.Int(values) for values in ([-1, 5, 1, 0], [-2, 1, 9, 3]))
    assert np.array(grid.index(row, column)).tolist() == [0, 9, 7, 3]


def test_coarser_images_are_half_as_large_rounded_up(arrays):
    grids = Grid.pyramid(arrays, 13, 6, 4)
    sizes = [(grid.height[0], grid.width[0]) for grid in grids]
    assert sizes == [(13, 6), (7, 3), (4, 2), (2, 1)]


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_box_means(arrays, height, width):
    given = image(height, width)
    grid = Grid.of(arrays, height, width)
    row, column, _ = grid.pixels()
    found = box_mean(among(channels(arrays, given.reshape(-1, 2))), grid, row, column)
    np.testing.assert_allclose(of_pixels(found, height, width), plain_fusion.box_mean(given), atol=1e-6)


@pytest.mark.parametrize("halvings", [1, 2])
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_block_means_are_over_the_pixels_that_there_are(arrays, height, width, halvings):
    given = image(height, width)
    grids = Grid.pyramid(arrays, height, width, 3)
    row, column, _ = grids[halvings].pixels()
    found = block_means(among(channels(arrays, given.reshape(-1, 2))), grids[0], row, column, halvings)
    expected = plain_fusion.block_means(given.astype(np.float64), 2**halvings)
    np.testing.assert_allclose(of_pixels(found, *expected.shape[:2]), expected, atol=1e-6)


@pytest.mark.parametrize("margin", [1, 4])
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_block_means_with_what_lies_around_the_blocks(arrays, height, width, margin):
    given = image(height, width)
    grids = Grid.pyramid(arrays, height, width, 3)
    row, column, _ = grids[2].pixels()
    found = block_means(among(channels(arrays, given.reshape(-1, 2))), grids[0], row, column, 2, margin)
    expected = plain_fusion.block_means_around(given.astype(np.float64), 4, margin)
    np.testing.assert_allclose(of_pixels(found, *expected.shape[:2]), expected, atol=1e-6)


@pytest.mark.parametrize("halvings", [1, 2])
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_values_between_the_pixels_of_a_coarser_image(arrays, height, width, halvings):
    grids = Grid.pyramid(arrays, height, width, 3)
    coarse = image(grids[halvings].height[0], grids[halvings].width[0])
    row, column, _ = grids[0].pixels()
    taps = grids[halvings].taps(row, column, halvings)
    found = interpolated(among(channels(arrays, coarse.reshape(-1, 2))), taps)
    expected = plain_fusion.enlarged(coarse, 2**halvings, (height, width))
    np.testing.assert_allclose(of_pixels(found, height, width), expected, atol=1e-6)


def test_channels_of_an_image_that_lies_pixel_by_pixel(arrays):
    given = image(4, 5, 3)
    found = pixels_of(floats(arrays, given.ravel()))(indices(arrays, [7, 0]))
    dr.eval(found)
    np.testing.assert_array_equal(host(found), given.reshape(-1, 3)[[7, 0]])
