"""The pixels of a disc on the device, and the rectangle around them in which they form an image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.fovea.region import FoveaRegion


@dataclass(frozen=True)
class Disc:
    """D pixels of a frame with their weights in the blend.

    Attributes:
        arrays: the backend's array types.
        width, height: frame in pixels.
        pixels: UInt (D,), row-major indices, ascending.
        weights: Float (D,), weight of the path-traced radiance in each of them, 0..1; it is 0 in all others.
        box: rows and columns of the rectangle around the pixels; None if there are none, or no image is made
            of them.
        covers_frame: whether the pixels are all of the frame and all weights are 1.
    """

    arrays: Arrays
    width: int
    height: int
    pixels: Any
    weights: Any
    box: tuple[slice, slice] | None
    covers_frame: bool = False

    @staticmethod
    def in_region(arrays: Arrays, region: FoveaRegion) -> Disc:
        """The pixels of a region, which are listed on the device."""
        plain, frame = arrays.plain, (region.width, region.height)
        if not region.count:
            return Disc(arrays, *frame, dr.zeros(plain.UInt, 0), dr.zeros(plain.Float, 0), None)
        if region.covers_frame:
            pixels, weights = dr.arange(plain.UInt, region.count), dr.full(plain.Float, 1, region.count)
        else:
            pixels, weights = _listed(arrays, region)
        # In one kernel with what needs them first.
        dr.schedule(pixels, weights)
        return Disc(arrays, *frame, pixels, weights, region.box, region.covers_frame)

    @property
    def count(self) -> int:
        """D, the number of pixels."""
        return dr.width(self.pixels)

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w), rows and columns of the rectangle."""
        assert self.box is not None, "a disc without pixels has no rectangle"
        rows, columns = self.box
        return rows.stop - rows.start, columns.stop - columns.start

    @cached_property
    def inside(self) -> Any:
        """UInt (D,), index of each pixel among those of the rectangle, row by row."""
        assert self.box is not None, "a disc without pixels has no rectangle"
        numbers = [self.box[0].start, self.box[1].start, self.shape[1]]
        top, left, across = self.arrays.scalars(self.arrays.plain.UInt, numbers)
        width = self.arrays.constant(self.width)
        row = self.pixels // width
        index = (row - top) * across + (self.pixels - row * width - left)
        dr.eval(index)
        return index

    @cached_property
    def _slots(self) -> Any:
        """Int (h * w,), which of the disc's pixels each pixel of the rectangle is; -1 outside the disc."""
        plain, size = self.arrays.plain, self.shape[0] * self.shape[1]
        slots = dr.full(plain.Int, -1, size)
        own = plain.Int(dr.arange(plain.UInt, self.count))
        dr.scatter(slots, own, self.inside, mode=dr.ReduceMode.Permute)
        dr.eval(slots)
        return slots

    def images(self, channels: list[Any], grounds: list[Any]) -> list[Any]:
        """Floats (h * w,) of the rectangle, not evaluated: channels (D,) in the disc, grounds elsewhere."""
        # At once: looked up one by one, each would take a kernel of its own.
        dr.eval(channels)
        inside = self._slots >= 0
        index = self.arrays.plain.UInt(dr.maximum(self._slots, 0))
        return [
            dr.select(inside, dr.gather(self.arrays.plain.Float, values, index, inside), ground)
            for values, ground in zip(channels, grounds, strict=True)
        ]

    def tensor(self, image: list[Any]) -> Any:
        """(h, w, 3) tensor of an image of the rectangle, three Floats (h * w,)."""
        plain = self.arrays.plain
        return plain.TensorXf(dr.ravel(plain.Array3f(*image)), (*self.shape, 3))

    def frame_image(self, channels: list[Any]) -> NDArray[np.float32]:
        """(H, W, C) host image of the frame from C Floats (D,) of the disc's pixels; 0 elsewhere."""
        size, plain = self.width * self.height, self.arrays.plain
        image = dr.zeros(plain.Float, size * len(channels))
        if self.count:
            for number, values in enumerate(channels):
                at = self.pixels * len(channels) + number
                dr.scatter(image, plain.Float(values), at, mode=dr.ReduceMode.Permute)
        return np.array(image).reshape(self.height, self.width, len(channels))


def _listed(arrays: Arrays, region: FoveaRegion) -> tuple[Any, Any]:
    """Row-major indices (D,) and weights (D,) of a region's pixels, not evaluated."""
    plain, (table, size) = arrays.plain, region.table()
    values = uploaded(plain.UInt, table)
    # Read at a literal, each would be copied on its own.
    end, one = arrays.constant(size), arrays.constant(1)

    def integer(at: Any) -> Any:
        return dr.gather(plain.UInt, values, at)

    def number(at: Any) -> Any:
        return dr.reinterpret_array(plain.Float, integer(2 * end + 2 + at))

    shift, outer, slope, faded = (number(end + i) for i in range(4))
    top, width = (integer(2 * end + i) for i in range(2))
    index = dr.arange(plain.UInt, region.count)
    row = dr.binary_search(0, size - 1, lambda at: integer(at + one) <= index)
    column = integer(end + row) + index - integer(row)
    radius = dr.sqrt(dr.square(plain.Float(column) + shift) + number(row))
    weight = dr.clip((outer - radius) * slope, 0, 1)
    return (top + row) * width + column, weight + (1 - weight) * faded
