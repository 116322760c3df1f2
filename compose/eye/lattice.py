"""The lattice on which what varies slowly over a frame is computed: the corners of its cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

CELL = 16  # pixels, both sides of a cell
# (rows + 1, columns + 1) values at the corners of the cells that cover a frame.
Lattice = NDArray[np.float32]


def corner_positions(width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x and y in pixels of the corners of a frame's cells, (rows + 1, columns + 1) each."""
    rows, columns = -(-height // CELL), -(-width // CELL)
    x, y = np.meshgrid(np.arange(columns + 1) * float(CELL), np.arange(rows + 1) * float(CELL))
    return x, y


def at_corners(image: NDArray[np.float32], width: int, height: int) -> Lattice:
    """A coarse image (h, w) of a frame at the corners of the frame's cells.

    It is interpolated bilinearly between its pixels' centres and constant beyond them.
    """
    x, y = corner_positions(width, height)
    position = [y / height * image.shape[0] - 0.5, x / width * image.shape[1] - 0.5]
    return map_coordinates(image, position, order=1, mode="nearest")


def per_pixel(lattice: Lattice, width: int, height: int) -> NDArray[np.float32]:
    """(H, W) values of a lattice at the pixels' centres, interpolated bilinearly."""
    y, x = (np.arange(size) + 0.5 for size in (height, width))
    row, column = (y // CELL).astype(int), (x // CELL).astype(int)
    fy, fx = (y / CELL - row)[:, None], (x / CELL - column)[None, :]
    rows = lattice[row] * (1 - fy) + lattice[row + 1] * fy
    return (rows[:, column] * (1 - fx) + rows[:, column + 1] * fx).astype(np.float32)
