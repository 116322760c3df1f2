"""The cells of a frame in which paths pay: which they are, and with which weights they cover the splats."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from compose.base.arrays import Arrays, uploaded
from compose.eye.detail import CELL

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, Int, UInt

    from compose.fovea.disc import Disc

# Share of the cells that do not cover the splats entirely, those that are worth least: so weights are
# continuous in whatever the worth depends on, and nothing pops.
_FADE = 0.2
# Width in pixels of the border of a cell towards one that is covered less.
_BAND = 3
# Pixels around a cell, in which denoising and fusion see its surroundings. Sides of tiles stay even, since
# the fusion judges blocks of 2 x 2 pixels.
BORDER = 4
_SIDE = CELL + 2 * BORDER


def chosen(worth: NDArray[np.floating], count: int) -> NDArray[np.float32]:
    """(rows, columns) weights, 0..1, of the `count` cells that are worth most; 0 of all others.

    The worth (rows, columns) is 0 or more; cells that are worth nothing are not chosen.
    """
    flat, weights = worth.ravel(), np.zeros(worth.size, dtype=np.float32)
    order = np.argsort(-flat, kind="stable")
    best = order[: min(count, np.count_nonzero(flat > 0))]
    if len(best):
        least = flat[order[count]] if count < worth.size else 0.0
        full = flat[best[min(int((1 - _FADE) * count), len(best) - 1)]] - least
        # Of cells that are all worth the same, any are as good as others.
        weights[best] = np.clip((flat[best] - least) / full, 0, 1) if full > 0 else 1
    return weights.reshape(worth.shape)


@dataclass(frozen=True)
class CellRegion:
    """Cells of CELL x CELL pixels that are path-traced, in the place of a disc."""

    width: int  # of the frame, in pixels
    height: int
    weights: NDArray[np.float32]  # (rows, columns) of the path-traced radiance in the cells, 0..1

    @cached_property
    def cells(self) -> NDArray[np.int64]:
        """(K,) row-major numbers of the cells, ascending."""
        return np.flatnonzero(self.weights > 0)

    @cached_property
    def count(self) -> int:
        """D, the number of their pixels."""
        row, column = np.divmod(self.cells, self.weights.shape[1])
        tall, wide = np.minimum(CELL, self.height - CELL * row), np.minimum(CELL, self.width - CELL * column)
        return int((tall * wide).sum())

    def disc(self, arrays: Arrays) -> Disc:
        """The pixels and their weights on the device."""
        from compose.fovea.disc import Disc

        plain, frame = arrays.plain, (self.width, self.height)
        if not self.count:
            return Disc(arrays, *frame, dr.zeros(plain.UInt, 0), dr.zeros(plain.Float, 0), None)
        row, column = np.divmod(self.cells, self.weights.shape[1])
        down, across = (
            slice(int(at.min()) * CELL, min((int(at.max()) + 1) * CELL, end))
            for at, end in ((row, self.height), (column, self.width))
        )
        pixels, weights = self._listed(arrays)
        dr.schedule(pixels, weights)
        tiling = Tiling(arrays, *frame, self.cells)
        return Disc(arrays, *frame, pixels, weights, (down, across), tiling=tiling)

    def _listed(self, arrays: Arrays) -> tuple[UInt, Float]:
        """Row-major indices UInt (D,) of the pixels, cell by cell, and their weights."""
        plain = arrays.plain
        numbers = uploaded(plain.UInt, self.cells.astype(np.uint32))
        lattices = uploaded(plain.Float, self.lattices())
        lane = dr.arange(plain.UInt, len(self.cells) * CELL**2)
        cell, place = lane // CELL**2, lane % CELL**2
        row, column = arrays.rows_columns(dr.gather(plain.UInt, numbers, cell), self.weights.shape[1])
        down, across = place // CELL, place % CELL
        # Bilinearly on the cell's lattice.
        y, x = _along(plain.Float(down)), _along(plain.Float(across))
        i, j = (plain.UInt(dr.minimum(at, 1)) for at in (y, x))
        taps = [dr.gather(plain.Float, lattices, cell * 9 + (i + k // 2) * 3 + j + k % 2) for k in range(4)]
        right, below = x - plain.Float(j), y - plain.Float(i)
        weight = dr.lerp(dr.lerp(taps[0], taps[1], right), dr.lerp(taps[2], taps[3], right), below)
        row, column = row * CELL + down, column * CELL + across
        pixel = row * arrays.constant(self.width) + column
        if self.count == len(self.cells) * CELL**2:
            return pixel, weight
        inside = (row < arrays.constant(self.height)) & (column < arrays.constant(self.width))
        dr.eval(pixel, weight, inside)
        kept = plain.UInt(dr.compress(inside))
        return dr.gather(plain.UInt, pixel, kept), dr.gather(plain.Float, weight, kept)

    def lattices(self) -> NDArray[np.float32]:
        """(K, 9) weights of each cell at its corners, on its sides and inside, 3 x 3 row by row.

        What cells share has the least weight of theirs.
        """
        padded, (rows, columns) = np.pad(self.weights, 1, mode="edge"), self.weights.shape
        beside = lambda y, x: padded[1 + y : 1 + y + rows, 1 + x : 1 + x + columns]  # noqa: E731
        every = [
            np.minimum.reduce([beside(y, x) for y in {0, down} for x in {0, across}])
            for down, across in product((-1, 0, 1), repeat=2)
        ]
        return np.stack(every, axis=-1).reshape(-1, 9)[self.cells]

    def foveal_tiles(self, tile: int) -> NDArray[np.bool_]:
        """(rows, columns) bool: cells that are traced and all that their borders reach; `tile` is CELL."""
        assert tile == CELL, "cells are tiles"
        return np.asarray(binary_dilation(self.weights > 0, np.ones((3, 3))))

    def peripheral_tiles(self, tile: int) -> NDArray[np.bool_]:
        """(rows, columns) bool: cells with a pixel in which splats are visible; `tile` is CELL."""
        assert tile == CELL, "cells are tiles"
        hidden = np.zeros(self.weights.size, dtype=bool)
        hidden[self.cells] = self.lattices().min(axis=1) >= 1
        return ~hidden.reshape(self.weights.shape)


def _along(place: Float) -> Float:
    """Where on the lattice of a cell, 0 to 2, a row or column of its pixels lies."""
    end = CELL - 0.5 - place
    return dr.minimum((place + 0.5) * (1 / _BAND), 1) + 1 - dr.minimum(end * (1 / _BAND), 1)


@dataclass(frozen=True)
class Tiling:
    """Cells of CELL x CELL pixels of a frame, wherever they lie, as tiles side by side in one image."""

    arrays: Arrays
    width: int  # of the frame, in pixels
    height: int
    cells: NDArray[np.int64]  # (K,) row-major numbers of the cells, at least one

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
        plain, across = self.arrays.plain, self.arrays.constant(-(-self.width // CELL))
        tile = dr.gather(plain.Int, self._tiles, row // CELL * across + column // CELL)
        known, tile = tile >= 0, plain.UInt(dr.maximum(tile, 0))
        down, right = self.arrays.rows_columns(tile, self._columns)
        down, right = (at * _SIDE + BORDER + of % CELL for at, of in ((down, row), (right, column)))
        return down * self.arrays.constant(self.shape[1]) + right, known

    @cached_property
    def _tiles(self) -> Int:
        """Int (rows * columns,), the tile of each cell of the frame; -1 if it has none."""
        tiles = np.full(-(-self.height // CELL) * -(-self.width // CELL), -1, dtype=np.int32)
        tiles[self.cells] = np.arange(len(self.cells), dtype=np.int32)
        return uploaded(self.arrays.plain.Int, tiles)
