"""The atlas has room for every sample that a frame looks up."""

from __future__ import annotations

import numpy as np
import pytest

from splat.lod.layer_images import LayerImage, Under, covered_cells, pack_atlas
from splat.raster.tiles import TILE


def weight(*points: tuple[int, int], corners: tuple[int, int] = (5, 7)) -> np.ndarray:
    """A lattice that is 1 at some corners and 0 elsewhere."""
    lattice = np.zeros(corners, np.float32)
    for point in points:
        lattice[point] = 1
    return lattice


def test_a_corner_covers_the_cells_around_it():
    covered = covered_cells(weight((1, 2)))
    assert covered.shape == (4, 6)
    assert {tuple(cell) for cell in np.argwhere(covered)} == {(0, 1), (0, 2), (1, 1), (1, 2)}


def test_images_lie_one_below_the_other():
    """6 x 4 cells of 16 px, tiles of 16 samples: 6 x 4 tiles at rate 0, 3 x 2 at rate 1, 2 x 1 at rate 2."""
    whole = np.ones((5, 7), np.float32)
    entries = pack_atlas(
        [LayerImage(3, 0, whole), LayerImage(2, 1, whole), LayerImage(1, 2, whole)], np.ones((4, 6), bool), 32
    )
    assert [entry.tiles.shape for entry in entries] == [(4, 6), (2, 3), (1, 2)]
    assert [entry.top for entry in entries] == [32, 96, 128]
    assert [entry.tile_rows for entry in entries] == [range(2, 6), range(6, 8), range(8, 9)]
    assert all(entry.tiles.all() for entry in entries)


def test_images_that_do_not_show_are_left_out():
    whole, none = np.ones((5, 7), np.float32), np.zeros((5, 7), np.float32)
    corner = weight((4, 6))
    wanted = np.ones((4, 6), bool)
    wanted[3, 5] = False
    images = [LayerImage(1, 0, none), LayerImage(2, 0, corner), LayerImage(3, 0, whole)]
    entries = pack_atlas(images, wanted)
    assert [entry.image.layer for entry in entries] == [3]
    assert entries[0].top == 0
    np.testing.assert_array_equal(entries[0].cells, wanted)
    np.testing.assert_array_equal(entries[0].tiles, wanted)


@pytest.mark.parametrize("rate", [0, 1, 2, 3])
@pytest.mark.parametrize("corner", [(0, 0), (2, 3), (4, 6)])
def test_tiles_hold_the_samples_of_all_covered_pixels(rate, corner):
    """Also those that a pixel at a border interpolates with; and not much more."""
    (entry,) = pack_atlas([LayerImage(1, rate, weight(corner))], np.ones((4, 6), bool))
    pixels = entry.cells.repeat(16, axis=0).repeat(16, axis=1)
    side, (height, width) = 1 << rate, pixels.shape
    for y, x in np.argwhere(pixels):
        low = [int(np.floor((p + 0.5) / side - 0.5)) for p in (y, x)] if rate else [y, x]
        for dy in (0, 1) if rate else (0,):
            for dx in (0, 1) if rate else (0,):
                v = np.clip(low[0] + dy, 0, -(-height // side) - 1)
                u = np.clip(low[1] + dx, 0, -(-width // side) - 1)
                assert entry.tiles[v // TILE, u // TILE]
    covered = entry.tiles.sum() * (TILE << rate) ** 2
    # The cells, a ring of cells around them at lower rates, and rounding up to tiles.
    assert covered <= ((2 + 2 * bool(rate)) * 16 + 2 * (TILE << rate)) ** 2


def test_full_rate_needs_no_ring():
    (entry,) = pack_atlas([LayerImage(1, 0, weight((2, 3)))], np.ones((4, 6), bool))
    np.testing.assert_array_equal(entry.tiles, entry.cells)
    assert entry.tiles.sum() == 4


def test_what_lies_under_a_frame_takes_the_rows_that_it_covers():
    cells = np.zeros((4, 6), bool)
    cells[1:3, 2:5] = True
    entry = Under(2, cells).entry(64)
    assert (entry.image.layer, entry.image.rate, entry.is_sharp) == (2, 0, True)
    # The frame's first row would be one row of tiles above the entry's.
    assert (entry.top, entry.first_row, entry.tile_rows) == (48, 1, range(4, 6))
    np.testing.assert_array_equal(entry.tiles, cells[1:3])
    np.testing.assert_array_equal(entry.cells, cells)
