"""Cells of a frame that are path-traced in the place of a disc, and the image that is made of them."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from compose.eye.detail import CELL
from compose.fovea.cells import BORDER, CellRegion, chosen
from tests import small
from tests.compose.arrays_of import channels, host, image_on

SIZES = [(64, 48), (70, 41), (16, 16), (5, 3)]


def some_cells(width: int, height: int, share: float = 0.4) -> CellRegion:
    """A random share of a frame's cells, half of them covered entirely; at least one."""
    rng, shape = small.rng(), (-(-height // CELL), -(-width // CELL))
    weights = np.where(rng.uniform(size=shape) < share, rng.choice([1.0, 0.3, 0.7], shape), 0)
    weights[-1, -1] = 1
    return CellRegion(width, height, weights.astype(np.float32))


def weight_at(region: CellRegion, row: int, column: int) -> float:
    """The weight of a pixel, in float64: linear within three pixels of what cells share."""
    rows, columns = region.weights.shape

    def along(place: int) -> float:
        start, end = (place + 0.5) / 3, (CELL - 0.5 - place) / 3
        return start if start < 1 else 2 - end if end < 1 else 1.0

    def shared(down: int, across: int) -> float:
        """Of the 3 x 3 lattice of the pixel's cell: the least weight of the cells that meet there."""
        around = [
            (np.clip(row // CELL + i, 0, rows - 1), np.clip(column // CELL + j, 0, columns - 1))
            for i in {0, down - 1}
            for j in {0, across - 1}
        ]
        return min(float(region.weights[at]) for at in around)

    down, across = along(row % CELL), along(column % CELL)
    i, j = min(int(down), 1), min(int(across), 1)
    v, u = down - i, across - j
    above = shared(i, j) * (1 - u) + shared(i, j + 1) * u
    return above * (1 - v) + (shared(i + 1, j) * (1 - u) + shared(i + 1, j + 1) * u) * v


def test_the_cells_that_are_worth_most_are_chosen():
    worth = small.rng().uniform(1, 2, (6, 9))
    for count in (0, 1, 7, 53, 54, 100):
        weights = chosen(worth, count)
        assert np.count_nonzero(weights) == min(count, worth.size)
        if 0 < count < worth.size:
            assert worth[weights > 0].min() > worth[weights == 0].max()
            assert np.count_nonzero(weights == 1) >= 0.8 * count
    assert not chosen(np.zeros((3, 3)), 4).any()
    assert np.count_nonzero(chosen(np.ones((3, 3)), 4) == 1) == 4
    np.testing.assert_array_equal(chosen(np.array([[0.0, 2.0]]), 2), [[0, 1]])


def test_weights_are_continuous_in_the_worth():
    worth = small.rng().exponential(size=(12, 16)) ** 2
    before = chosen(worth, 40)
    for _ in range(20):
        worth = worth * (1 + 1e-3 * small.rng().standard_normal(worth.shape))
        after = chosen(worth, 40)
        assert np.abs(after - before).max() < 0.05
        before = after


@pytest.mark.parametrize("size", SIZES)
def test_pixels_and_weights_are_those_of_the_twin(arrays, size):
    region = some_cells(*size)
    disc = region.disc(arrays)
    expected = np.zeros((region.height, region.width))
    for row, column in np.ndindex(expected.shape):
        if region.weights[row // CELL, column // CELL]:
            expected[row, column] = weight_at(region, row, column)
    pixels = np.array(disc.pixels)
    assert len(np.unique(pixels)) == len(pixels) == region.count == np.count_nonzero(expected)
    np.testing.assert_allclose(np.array(disc.weights), expected.ravel()[pixels], atol=1e-6)
    rows, columns = disc.box
    assert rows.stop <= region.height
    assert columns.stop <= region.width
    assert np.isin(pixels // region.width, np.arange(rows.start, rows.stop)).all()


@pytest.mark.parametrize("size", SIZES)
def test_tiles_show_their_cells_and_what_surrounds_them(arrays, size):
    region = some_cells(*size)
    disc, (width, height) = region.disc(arrays), size
    frame = small.rng().uniform(1, 2, (height, width, 3)).astype(np.float32)
    traced = -frame.reshape(-1, 3)[np.array(disc.pixels)]
    ground = disc.of_frame(image_on(arrays, frame))
    image = host(disc.images(channels(arrays, traced), ground)).reshape(*disc.shape, 3)
    side, columns = CELL + 2 * BORDER, disc.shape[1] // (CELL + 2 * BORDER)
    # Traced pixels are negative, wherever they are seen.
    signed = (
        np.where(np.kron(region.weights > 0, np.ones((CELL, CELL)))[:height, :width, None] > 0, -1, 1) * frame
    )
    for number, cell in enumerate(region.cells):
        top, left = (CELL * at for at in divmod(cell, region.weights.shape[1]))
        y, x = (np.arange(side) - BORDER + first for first in (top, left))
        shown = signed[np.clip(y, 0, height - 1)][:, np.clip(x, 0, width - 1)]
        row, column = divmod(number, columns)
        tile = image[row * side : (row + 1) * side, column * side : (column + 1) * side]
        np.testing.assert_array_equal(tile, shown)
    np.testing.assert_array_equal(image.reshape(-1, 3)[np.array(disc.inside)], traced)


def test_splats_are_drawn_where_they_show(arrays):
    full = np.ones((7, 10), np.float32)
    full[2, 3], full[5, 8] = 0, 0.5
    region = CellRegion(160, 100, full)
    disc = region.disc(arrays)
    weights = disc.frame_image([disc.weights])[..., 0]
    cells = np.pad(weights, ((0, -100 % CELL), (0, 0)), constant_values=1).reshape(7, CELL, 10, CELL)
    shown = region.peripheral_tiles(CELL)
    np.testing.assert_array_equal(shown, cells.min(axis=(1, 3)) < 1)
    assert 0 < np.count_nonzero(shown) < shown.size
    under = region.foveal_tiles(CELL)
    y, x = (np.array(at) // CELL for at in disc.tiling.pixels)
    assert under[y, x].all()


def test_no_cell_is_no_pixel(arrays):
    region = CellRegion(40, 30, np.zeros((2, 3), np.float32))
    disc = region.disc(arrays)
    assert region.count == disc.count == dr.width(disc.weights) == 0
    assert region.peripheral_tiles(CELL).all()
    assert not region.foveal_tiles(CELL).any()
