"""The grid of tiles covers the frame."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from splat.raster.tiles import TileGrid


@pytest.mark.parametrize(
    ("size", "side", "expected"),
    [((32, 16), 16, (2, 1)), ((33, 17), 16, (3, 2)), ((1, 1), 16, (1, 1)), ((33, 17), 8, (5, 3))],
)
def test_tiles_are_rounded_up(size, side, expected):
    grid = TileGrid(*size, side)
    assert (grid.columns, grid.rows) == expected
    assert (grid.padded_width, grid.padded_height) == (expected[0] * side, expected[1] * side)


def test_all_tiles_are_wanted_by_default():
    assert TileGrid(33, 17).mask(None).tolist() == [[True] * 3] * 2
    wanted = np.eye(2, 3, dtype=bool)
    assert TileGrid(33, 17).mask(wanted) is wanted


def test_a_mask_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"wanted has shape \(3, 2\), expected \(2, 3\)"):
        TileGrid(33, 17).mask(np.ones((3, 2), dtype=bool))


def test_frames_of_too_many_tiles_are_refused():
    assert TileGrid(1, 1 << 20).rows == 1 << 16
    with pytest.raises(UserError, match=r"frame of 1 x 1048577: at most 1,048,576 pixels along a side"):
        TileGrid(1, (1 << 20) + 1)


def test_frames_of_too_many_pixels_are_refused():
    assert TileGrid(32_768, 32_752).columns == 2048
    with pytest.raises(UserError, match="frame of 32768 x 32753: at most 1,073,741,823 pixels"):
        TileGrid(32_768, 32_753)
