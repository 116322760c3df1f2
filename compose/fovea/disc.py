"""The disc on the device: its pixels and their image, fewer samples in its band, and the blend with splats.

In the band each pixel gets samples in proportion to its weight in the blend, which is in linear radiance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.base.traced_samples import Counts
from compose.fovea.cells import Tiling
from compose.fovea.foveation import FoveaRegion
from compose.image.device_image import Box, DeviceImage, shape_of

if TYPE_CHECKING:
    from drjit.auto.ad import Float, Int, TensorXf, UInt

# Steps of a dither mask per column and row, in units of 2 ** -32, that leave no clumps or stripes: the
# golden ratio's counterpart in the plane (Roberts 2018, "The unreasonable effectiveness of quasirandom
# sequences").
_ACROSS, _DOWN = 3242174889, 2447445414


@dataclass(frozen=True)
class Disc:
    """D pixels of a frame with their weights in the blend."""

    arrays: Arrays
    width: int  # of the frame, in pixels
    height: int
    pixels: UInt  # (D,) row-major indices, each once
    weights: Float  # (D,) of the path-traced radiance, 0..1; it is 0 in all other pixels
    box: Box | None  # the rectangle around the pixels; None if there are none, or no image is made of them
    covers_frame: bool = False  # whether the pixels are all of the frame and all weights are 1
    tiling: Tiling | None = None  # of pixels scattered over the frame; None if the image is the rectangle

    @staticmethod
    def in_region(arrays: Arrays, region: FoveaRegion) -> Disc:
        """The pixels of a region, listed on the device."""
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
        """(h, w), rows and columns of the image that is made of the pixels."""
        assert self.box is not None, "a disc without pixels has no image"
        return shape_of(self.box) if self.tiling is None else self.tiling.shape

    @cached_property
    def inside(self) -> UInt:
        """UInt (D,), index of each pixel among those of the image, row by row."""
        assert self.box is not None, "a disc without pixels has no image"
        if self.tiling is not None:
            index, _ = self.tiling.index(*self.arrays.rows_columns(self.pixels, self.width))
            dr.eval(index)
            return index
        top, left, across = self._place
        row, column = self.arrays.rows_columns(self.pixels, self.width)
        index = (row - top) * across + (column - left)
        # In one kernel with what needs it first.
        dr.schedule(index)
        return index

    @cached_property
    def _place(self) -> list[UInt]:
        """First row and column of the rectangle and its width, each of width 1."""
        assert self.box is not None, "a disc without pixels has no image"
        numbers = [self.box[0].start, self.box[1].start, self.shape[1]]
        return self.arrays.scalars(self.arrays.plain.UInt, numbers)

    @cached_property
    def _slots(self) -> Int:
        """Int (h * w,), which of the disc's pixels each pixel of the image shows; -1 outside the disc."""
        plain, size = self.arrays.plain, self.shape[0] * self.shape[1]
        slots = dr.full(plain.Int, -1, size)
        own = plain.Int(dr.arange(plain.UInt, self.count))
        dr.scatter(slots, own, self.inside, mode=dr.ReduceMode.Permute)
        dr.eval(slots)
        if self.tiling is not None:
            # The border of a tile shows what cells beside it have.
            index, known = self.tiling.index(*self.tiling.pixels)
            slots = dr.select(known, dr.gather(plain.Int, slots, index, known), -1)
            dr.eval(slots)
        return slots

    def of_frame(self, image: DeviceImage) -> list[Float]:
        """Three Floats (h * w,), the radiance that an image of the frame has in the pixels of this one."""
        if self.tiling is not None:
            return image.at(*self.tiling.pixels)
        height, width = self.shape
        row, column = self.arrays.rows_columns(dr.arange(self.arrays.plain.UInt, height * width), width)
        top, left, _ = self._place
        return image.at(row + top, column + left)

    def images(self, channels: Sequence[Float], grounds: Sequence[Float | float]) -> list[Float]:
        """Floats (h * w,) of the image, not evaluated: channels (D,) in the disc, grounds elsewhere."""
        # At once: looked up one by one, each would take a kernel of its own.
        dr.eval(channels)
        inside = self._slots >= 0
        index = self.arrays.plain.UInt(dr.maximum(self._slots, 0))
        return [
            dr.select(inside, dr.gather(self.arrays.plain.Float, values, index, inside), ground)
            for values, ground in zip(channels, grounds, strict=True)
        ]

    def tensor(self, image: list[Float]) -> TensorXf:
        """(h, w, 3) tensor of the image, three Floats (h * w,)."""
        plain = self.arrays.plain
        return plain.TensorXf(dr.ravel(plain.Array3f(*image)), (*self.shape, 3))

    def frame_image(self, channels: list[Float]) -> NDArray[np.float32]:
        """(H, W, C) host image of the frame from C Floats (D,) of the disc's pixels; 0 elsewhere."""
        size, plain = self.width * self.height, self.arrays.plain
        image = dr.zeros(plain.Float, size * len(channels))
        if self.count:
            for number, values in enumerate(channels):
                at = self.pixels * len(channels) + number
                dr.scatter(image, plain.Float(values), at, mode=dr.ReduceMode.Permute)
        return np.array(image).reshape(self.height, self.width, len(channels))


def _listed(arrays: Arrays, region: FoveaRegion) -> tuple[UInt, Float]:
    """Row-major indices and weights of a region's pixels."""
    plain, (table, size) = arrays.plain, region.table()
    values = uploaded(plain.UInt, table)
    # Read at a literal, each would be copied on its own.
    end, one = arrays.constant(size), arrays.constant(1)
    integer = lambda at: dr.gather(plain.UInt, values, at)  # noqa: E731
    number = lambda at: dr.reinterpret_array(plain.Float, integer(2 * end + 2 + at))  # noqa: E731
    shift, outer, slope, faded = (number(end + i) for i in range(4))
    top, width = (integer(2 * end + i) for i in range(2))
    index = dr.arange(plain.UInt, region.count)
    row = dr.binary_search(0, size - 1, lambda at: integer(at + one) <= index)
    column = integer(end + row) + index - integer(row)
    radius = dr.sqrt(dr.square(plain.Float(column) + shift) + number(row))
    weight = dr.clip((outer - radius) * slope, 0, 1)
    return (top + row) * width + column, weight + (1 - weight) * faded


def thinned(disc: Disc, spp: int, seed: int) -> tuple[Disc, int | Counts]:
    """The pixels of a disc that get samples, with adjusted weights, and how many each gets, at least 1.

    Averaged over seeds of the rounding, the blend is that of the whole disc. A pixel with weight w and n
    samples of variance v has noise of variance w^2 v / n. For a given number of samples the sum of this over
    all pixels is least with n in proportion to w (Neyman 1934): n = spp w. It is rounded to a whole number at
    random, but evenly over the image. A pixel that is due less than one sample has weight 1 / spp if it gets
    one, and shows the splats if it does not. So no pixel of the band is noisier than those inside it, as long
    as both images agree.
    """
    if disc.covers_frame or not disc.count:
        return disc, spp
    plain = disc.arrays.plain
    start = int(np.random.SeedSequence(seed).generate_state(1)[0])
    start, most = disc.arrays.scalars(plain.UInt, [start, spp])
    row, column = disc.arrays.rows_columns(disc.pixels, disc.width)
    # The sum wraps around on purpose: only its fractional part counts.
    mask = plain.Float64(column * _ACROSS + row * _DOWN + start) * 2.0**-32
    due = dr.floor(plain.Float64(most) * plain.Float64(disc.weights) + mask)
    count = dr.select(disc.weights < 1, plain.UInt(due), most)
    has_samples = count > 0
    # At once, before the pixels that are kept look it up.
    dr.eval(count, has_samples)
    kept = plain.UInt(dr.compress(has_samples))
    if not dr.width(kept):
        return replace(disc, pixels=dr.zeros(plain.UInt, 0), weights=dr.zeros(plain.Float, 0), box=None), spp
    pixels, count = (dr.gather(plain.UInt, of, kept) for of in (disc.pixels, count))
    weights = dr.maximum(dr.gather(plain.Float, disc.weights, kept), 1 / plain.Float(most))
    # In one kernel with what needs them first.
    dr.schedule(pixels, count, weights)
    return replace(disc, pixels=pixels, weights=weights), 1 if spp == 1 else Counts.of(count, spp)


def blend(periphery: DeviceImage, fovea: list[Float], disc: Disc) -> tuple[DeviceImage, list[Float]]:
    """The composite, (1 - w) periphery + w fovea in the disc of weights w, in the memory of the periphery.

    Copying that would take longer than the blend. The fovea is three Floats (D,), linear radiance of the
    disc's pixels. Returns also what the periphery showed there, three Floats (D,).
    """
    if not disc.count:
        return periphery, [disc.weights] * 3
    behind = periphery.of_pixels(disc.pixels)
    if disc.covers_frame:
        # Nothing of the periphery is left.
        return DeviceImage.filled(periphery.arrays, periphery.width, periphery.height, fovea), behind
    # Full weights copy instead of multiplying: 0 times a lamp's infinity is not 0.
    full = disc.weights >= 1
    values = [
        dr.select(full, front, back * (1 - disc.weights) + front * disc.weights)
        for front, back in zip(fovea, behind, strict=True)
    ]
    # What still waits to be read from the periphery would have all of it copied when it is written.
    dr.eval(values, behind)
    return periphery.changed(disc.pixels, values), behind
