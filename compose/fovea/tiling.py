"""Cells of a frame, wherever they lie, side by side in one image, each with a border of what surrounds it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.eye.detail import CELL

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Int, UInt

# Pixels around a cell, in which denoising and fusion see its surroundings. Sides of tiles stay even, since
# the fusion judges blocks of 2 x 2 pixels.
BORDER = 4
_SIDE = CELL + 2 * BORDER


@dataclass(frozen=True)
class Tiling:
    """K cells of CELL x CELL pixels of a frame as tiles of one image.

    Attributes:
        width, height: frame in pixels.
        cells: (K,) row-major numbers of the cells, at least one.
    """

    arrays: Arrays
    width: int
    height: int
    cells: NDArray[np.int64]

    @property
    def _columns(self) -> int:
        return math.ceil(math.sqrt(len(self.cells)))

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w) of the image."""
        return -(-len(self.cells) // self._columns) * _SIDE, self._columns * _SIDE

    @cached_property
    def pixels(self) -> tuple[UInt, UInt]:
        """Rows and columns, UInt (h * w,), of the frame's pixels that those of the image show.

        Tiles that are left over show the last cell again, borders beyond the frame its outermost pixels.
        """
        plain, constant = self.arrays.plain, self.arrays.constant
        size = self.shape[0] * self.shape[1]
        down, across = self.arrays.rows_columns(dr.arange(plain.UInt, size), self.shape[1])
        tile = down // _SIDE * constant(self._columns) + across // _SIDE
        number = dr.minimum(tile, constant(len(self.cells) - 1))
        cell = dr.gather(plain.UInt, uploaded(plain.UInt, self.cells.astype(np.uint32)), number)
        corner = self.arrays.rows_columns(cell, -(-self.width // CELL))
        found = []
        for at, first, end in zip((down, across), corner, (self.height, self.width), strict=True):
            place = plain.Int(first * CELL + at % _SIDE) - BORDER
            found.append(plain.UInt(dr.clip(place, 0, plain.Int(constant(end - 1)))))
        dr.eval(found)
        return found[0], found[1]

    def index(self, row: UInt, column: UInt) -> tuple[UInt, Bool]:
        """Which pixel of the image, UInt, shows a pixel of the frame in its tile; and whether one does."""
        plain = self.arrays.plain
        tile = dr.gather(plain.Int, self._tiles, row // CELL * self._across + column // CELL)
        known, tile = tile >= 0, plain.UInt(dr.maximum(tile, 0))
        down, across = self.arrays.rows_columns(tile, self._columns)
        down, across = (at * _SIDE + BORDER + of % CELL for at, of in ((down, row), (across, column)))
        return down * self.arrays.constant(self.shape[1]) + across, known

    @cached_property
    def _across(self) -> UInt:
        return self.arrays.constant(-(-self.width // CELL))

    @cached_property
    def _tiles(self) -> Int:
        """Int (rows * columns,), the tile of each cell of the frame; -1 if it has none."""
        tiles = np.full(-(-self.height // CELL) * -(-self.width // CELL), -1, dtype=np.int32)
        tiles[self.cells] = np.arange(len(self.cells), dtype=np.int32)
        return uploaded(self.arrays.plain.Int, tiles)
