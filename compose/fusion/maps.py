"""Images and coarser ones of them, on the device: their pixels, looked up by row and column.

A coarser image has half as many rows and columns, rounded up. What lies beyond a border is like the pixels
at the border.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import drjit as dr

from compose.base.arrays import Arrays
from compose.base.frozen import capacity
from compose.image.device_image import bilinear_taps

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, Float64, Int, UInt

_Value = TypeVar("_Value", "Float", "Float64")


def among(channels: Sequence[_Value]) -> Callable[[UInt], list[_Value]]:
    """The function from indices of pixels to the values of some channels."""
    return lambda index: [dr.gather(type(values), values, index) for values in channels]


def pixels_of(image: Float) -> Callable[[UInt], list[Float]]:
    """The function from indices of pixels to the three channels of an image that lies pixel by pixel."""
    return lambda index: [dr.gather(type(image), image, index * 3 + k) for k in range(3)]


@dataclass(frozen=True)
class Grid:
    """The pixels of an image."""

    arrays: Arrays
    height: UInt  # of width 1, as the width
    width: UInt
    lanes: int  # of a kernel for all pixels, at least as many

    @staticmethod
    def of(arrays: Arrays, height: int, width: int) -> Grid:
        """The pixels of an image of a size."""
        return Grid(arrays, arrays.constant(height), arrays.constant(width), capacity(height * width))

    @staticmethod
    def pyramid(arrays: Arrays, height: int, width: int, levels: int) -> list[Grid]:
        """The pixels of an image and of coarser ones, as many as there are levels."""
        sizes = [(height, width)]
        for _ in range(levels - 1):
            sizes.append((-(-sizes[-1][0] // 2), -(-sizes[-1][1] // 2)))
        return [Grid.of(arrays, *size) for size in sizes]

    def pixels(self) -> tuple[Int, Int, Bool]:
        """Rows and columns of the pixels, and which lanes have one."""
        Int = self.arrays.plain.Int
        lane = dr.arange(self.arrays.plain.UInt, self.lanes)
        row = lane // self.width
        return Int(row), Int(lane - row * self.width), row < self.height

    def index(self, row: Int, column: Int) -> UInt:
        """Row-major indices of pixels, or of those that are nearest to them."""
        Int, UInt = self.arrays.plain.Int, self.arrays.plain.UInt
        row, column = (
            dr.clip(at, 0, Int(size) - 1) for at, size in ((row, self.height), (column, self.width))
        )
        return UInt(row) * self.width + UInt(column)

    def taps(self, row: Int, column: Int, halvings: int) -> list[tuple[UInt, Float]]:
        """Indices of the four pixels around those of an image `halvings` times finer, and their weights."""
        scale, Float = 0.5**halvings, self.arrays.plain.Float
        y, x = ((Float(at) + 0.5) * scale for at in (row, column))
        around = bilinear_taps(self.arrays, x, y, self.width, self.height)
        return [(i * self.width + j, weight) for i, j, weight in around]


def interpolated(
    values_at: Callable[[UInt], Sequence[_Value]], taps: list[tuple[UInt, Float]]
) -> list[_Value]:
    """Sums of values at the taps of `Grid.taps`, by their weights."""
    rows = [[value * type(value)(weight) for value in values_at(index)] for index, weight in taps]
    return [dr.sum(list(of)) for of in zip(*rows, strict=True)]


def box_mean(
    values_at: Callable[[UInt], Sequence[_Value]], grid: Grid, row: Int, column: Int
) -> list[_Value]:
    """Means of values over windows of 3 x 3 pixels."""
    around = [values_at(grid.index(row + i, column + j)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return [dr.sum(list(of)) * (1 / 9) for of in zip(*around, strict=True)]


def block_means(
    values_at: Callable[[UInt], Sequence[_Value]],
    fine: Grid,
    row: Int,
    column: Int,
    halvings: int,
    margin: int = 0,
) -> list[_Value]:
    """Means of values over the pixels of a fine image that pixels of one `halvings` times coarser cover.

    And over those around them, up to a margin in pixels of the fine image.
    """
    integer, side = fine.arrays.plain.Int, (1 << halvings) + 2 * margin
    top, left = ((at << halvings) - margin for at in (row, column))

    def added(number: Int, count: Int, sums: list[_Value]) -> tuple[Int, Int, list[_Value]]:
        i, j = top + number // side, left + number % side
        inside = (i >= 0) & (j >= 0) & (i < integer(fine.height)) & (j < integer(fine.width))
        found = values_at(fine.index(i, j))
        sums = [total + dr.select(inside, value, 0) for total, value in zip(sums, found, strict=True)]
        return number + 1, count + dr.select(inside, integer(1), 0), sums

    none = dr.zeros(integer, dr.width(row))
    kinds = [type(value) for value in values_at(fine.index(top, left))]
    start = [dr.zeros(kind, dr.width(row)) for kind in kinds]
    # Lanes without a pixel have nothing to do.
    used = top + margin < integer(fine.height)
    _, count, sums = dr.while_loop(
        (none, none + 0, start), lambda number, *_: used & (number < side * side), added, label="block means"
    )
    return [total / type(total)(dr.maximum(count, 1)) for total in sums]
