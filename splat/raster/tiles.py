"""The grid of square tiles that the rasterizer works on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.base.errors import UserError
from splat.model.points import Bits

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

# Each tile has 4 x 4 lanes: they fill one AVX-512 vector and half a warp.
LANES_ACROSS = 4
# 16 x 16 pixels, 4 x 4 per lane: the more pixels a splat covers, the more a large tile saves.
TILE = 16
# Rows and columns of tiles are numbered by 16 bits each.
_MOST_TILES = 1 << 16
# Four floats each, and Dr.Jit's arrays have fewer than 2^32 elements.
_MOST_PIXELS = (1 << 30) - 1


@dataclass(frozen=True)
class GridNumbers:
    """A grid as kernels read it, UInts of width 1 in memory: the same kernels serve all frames."""

    side: int  # of a tile in pixels
    columns: UInt
    tiles: UInt  # columns * rows
    width: UInt  # of all tiles in pixels


@dataclass(frozen=True)
class TileGrid:
    """A frame divided into tiles; those at the right and at the bottom may reach beyond it.

    UserError if the frame has more than 65,536 tiles along a side, or 2^30 pixels.
    """

    width: int  # width, height: frame in pixels
    height: int
    side: int = TILE  # of a tile in pixels, a multiple of 4

    def __post_init__(self) -> None:
        if max(self.columns, self.rows) > _MOST_TILES:
            most = _MOST_TILES * self.side
            raise UserError(f"frame of {self.width} x {self.height}: at most {most:,} pixels along a side")
        if self.padded_width * self.padded_height > _MOST_PIXELS:
            raise UserError(f"frame of {self.width} x {self.height}: at most {_MOST_PIXELS:,} pixels")

    @property
    def columns(self) -> int:
        """Tiles per row."""
        return -(-self.width // self.side)

    @property
    def rows(self) -> int:
        """Tiles per column."""
        return -(-self.height // self.side)

    @property
    def padded_width(self) -> int:
        """Width of all tiles in pixels."""
        return self.columns * self.side

    @property
    def padded_height(self) -> int:
        """Height of all tiles in pixels."""
        return self.rows * self.side

    def numbers(self, arrays: Arrays) -> GridNumbers:
        """The grid on the device."""
        sizes = self.columns, self.columns * self.rows, self.padded_width
        return GridNumbers(self.side, *map(arrays.constant, sizes))

    def mask(self, wanted: Bits | None) -> Bits:
        """(rows, columns) the wanted tiles; None stands for all. ValueError if the mask has another shape."""
        shape = self.rows, self.columns
        if wanted is None:
            return np.ones(shape, dtype=bool)
        if wanted.shape != shape:
            raise ValueError(f"wanted has shape {wanted.shape}, expected {shape}")
        return wanted


def between_corners(
    arrays: Arrays,
    at: Callable[[UInt], Float],
    first: UInt | int,
    size: tuple[UInt, UInt],
    x: Float,
    y: Float,
) -> Float:
    """A lattice at positions in pixels, linear between the corners of tiles and constant beyond the frame.

    Args:
        at: the Float at an index.
        first: index of the first corner; the others follow row by row.
        size: rows and columns of corners, of width 1.
    """
    Float, UInt, (rows, columns) = arrays.plain.Float, arrays.plain.UInt, size
    u = dr.clip(x * (1 / TILE), 0, Float(columns) - 1.001)
    v = dr.clip(y * (1 / TILE), 0, Float(rows) - 1.001)
    column, row = UInt(u), UInt(v)
    corner, fu, fv = first + row * columns + column, u - Float(column), v - Float(row)
    above, below = (dr.lerp(at(left), at(left + 1), fu) for left in (corner, corner + columns))
    return dr.lerp(above, below, fv)
