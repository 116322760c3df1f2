"""Values at the corners of cells, and between them."""

from __future__ import annotations

import numpy as np

from compose.eye.detail import CELL, DetailMap, at_corners, corner_positions


def per_pixel(lattice: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) values of a map's lattice at the pixels of its frame."""
    return DetailMap(width, height, 1, lattice, lattice, lattice, (), lattice).per_pixel(lattice)


def test_corners_enclose_the_frame():
    """40 x 17 pixels take 3 x 2 cells of 16 pixels."""
    x, y = corner_positions(40, 17)
    assert CELL == 16
    assert x.tolist() == [[0, 16, 32, 48]] * 3
    assert y.T.tolist() == [[0, 16, 32]] * 4


def test_a_coarse_image_at_the_corners_of_cells():
    """64 x 32 pixels in two halves: linear between the centres at x = 16 and 48, constant beyond them."""
    image = np.array([[0.0, 1.0]], np.float32)
    np.testing.assert_allclose(at_corners(image, 64, 32), np.tile([0, 0, 0.5, 1, 1], (3, 1)), atol=1e-6)
    turned = at_corners(np.ascontiguousarray(image.T), 32, 64)
    np.testing.assert_allclose(turned, np.tile([0, 0, 0.5, 1, 1], (3, 1)).T, atol=1e-6)


def test_a_plane_is_interpolated_exactly():
    x, y = corner_positions(40, 17)
    lattice = (2 * x - 3 * y + 1).astype(np.float32)
    found = per_pixel(lattice, 40, 17)
    row, column = np.mgrid[0:17, 0:40] + 0.5
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, 2 * column - 3 * row + 1, atol=1e-4)


def test_interpolation_uses_the_four_corners_of_a_cell_only():
    lattice = np.zeros((3, 4), np.float32)
    lattice[1, 2] = 1
    found = per_pixel(lattice, 40, 17)
    # The peak lies at (32, 16); the nearest pixel centres are half a pixel away along both axes.
    np.testing.assert_allclose(found[15:17, 31:33], (31 / 32) ** 2, rtol=1e-6)
    assert (found[:, :16] == 0).all()
    assert found[8, 24] > 0
