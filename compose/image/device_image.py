"""Images in the memory of the device that renders them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.image.colour import MOST, SRGB_DARK, SRGB_GAMMA, SRGB_OFFSET, SRGB_SCALE, SRGB_SLOPE

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, TensorXf, UInt

# Rows and columns of a rectangle of an image.
Box = tuple[slice, slice]


def shape_of(box: Box) -> tuple[int, int]:
    """(h, w), the number of rows and columns of a rectangle."""
    rows, columns = box
    return rows.stop - rows.start, columns.stop - columns.start


def srgb_curve(linear: Float) -> Float:
    """Floats from 0 to 1 on the sRGB curve, as in compose.image.colour; NaN stays."""
    curve = dr.fma(SRGB_SCALE, linear ** (1 / SRGB_GAMMA), -SRGB_OFFSET)
    return dr.select(linear <= SRGB_DARK, SRGB_SLOPE * linear, curve)


def srgb_bytes(arrays: Arrays, flat: Float, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """sRGB bytes in host memory, of a shape, of linear radiance: all that leaves the device of a frame."""
    value = dr.fma(srgb_curve(arrays.plain.Float(dr.fmin(dr.fmax(flat, 0), 1))), 255, 0.5)
    return np.asarray(arrays.plain.UInt8(value)).reshape(shape)


def all_plain(channels: Sequence[Float]) -> bool:
    """Whether Dr.Jit floats, which this waits for, are finite, not negative and at most MOST, as usual."""
    wrong = [~((values >= 0) & (values <= MOST)) for values in channels]
    return not bool(dr.any(reduce(or_, wrong)))


def bilinear_taps(
    arrays: Arrays, x: Float, y: Float, width: UInt, height: UInt
) -> list[tuple[UInt, UInt, Float]]:
    """Rows, columns and weights of the four samples of a grid around positions, or of those at its border.

    Sizes and positions count samples, whose centres lie at +0.5.
    """
    plain, axes = arrays.plain, []
    for at, size in ((y, height), (x, width)):
        last = size - 1
        place = dr.clip(at - 0.5, 0, plain.Float(last))
        first = plain.UInt(place)
        share = place - plain.Float(first)
        axes.append(((first, 1 - share), (dr.minimum(first + 1, last), share)))
    return [(i, j, down * along) for i, down in axes[0] for j, along in axes[1]]


@dataclass(frozen=True)
class DeviceImage:
    """An image of linear radiance, possibly part of a larger buffer."""

    arrays: Arrays
    values: Float  # rows of `stride` pixels, of each of which the first three channels count
    width: int  # of the image, in pixels
    height: int
    stride: int  # pixels per row of the buffer
    channels: int = 3  # floats per pixel
    first_row: int = 0  # of the image that is in the buffer; rows that are not in it are black

    @staticmethod
    def filled(arrays: Arrays, width: int, height: int, channels: list[Float]) -> DeviceImage:
        """An image from three Floats (H * W,)."""
        values = arrays.plain.Float(dr.ravel(arrays.plain.Array3f(*channels)))
        dr.eval(values)
        return DeviceImage(arrays, values, width, height, width)

    @property
    def is_packed(self) -> bool:
        """Whether the buffer holds nothing but the image."""
        floats = 3 * self.width * self.height
        return (self.stride, self.channels, dr.width(self.values)) == (self.width, 3, floats)

    @property
    def is_whole(self) -> bool:
        """Whether all rows are in the buffer."""
        return not self.first_row and dr.width(self.values) >= self.height * self.stride * self.channels

    def _place(self, row: UInt, column: UInt) -> tuple[UInt, Bool | bool]:
        """Where in the buffer pixels start, and whether they are in it."""
        known: Bool | bool = True
        if not self.is_whole:
            # What lies above wraps around to beyond the buffer.
            row = row - self.arrays.constant(self.first_row)
            known = row < self.arrays.constant(dr.width(self.values) // (self.stride * self.channels))
        return (row * self.arrays.constant(self.stride) + column) * self.channels, known

    def at(self, row: UInt, column: UInt) -> list[Float]:
        """Three Floats (N,), the radiance of pixels."""
        index, known = self._place(row, column)
        return [dr.gather(self.arrays.plain.Float, self.values, index + c, known) for c in range(3)]

    def of_pixels(self, pixels: UInt) -> list[Float]:
        """Three Floats (N,), the radiance of pixels by their row-major indices UInt (N,)."""
        return self.at(*self.arrays.rows_columns(pixels, self.width))

    def changed(self, pixels: UInt, channels: list[Float]) -> DeviceImage:
        """The image, in its own memory if it is whole, with other radiance in some pixels.

        Those are given by their row-major indices (N,), each once, their radiance as three Floats (N,).
        """
        image = self if self.is_whole else self.packed()
        index, _ = image._place(*self.arrays.rows_columns(pixels, self.width))
        for number, values in enumerate(channels):
            dr.scatter(image.values, values, index + number, mode=dr.ReduceMode.Permute)
        dr.eval(image.values)
        return image

    def flat(self) -> Float:
        """Float (H * W * 3,), the image row by row, not evaluated."""
        if self.is_packed:
            return self.values
        index = dr.arange(self.arrays.plain.UInt, self.width * self.height * 3)
        pixel = index // 3
        at, known = self._place(*self.arrays.rows_columns(pixel, self.width))
        return dr.gather(self.arrays.plain.Float, self.values, at + index - pixel * 3, known)

    def packed(self) -> DeviceImage:
        """The image in a buffer of its own that holds nothing else."""
        values = self.arrays.plain.Float(self.flat())
        dr.eval(values)
        return DeviceImage(self.arrays, values, self.width, self.height, self.width)

    def tensor(self) -> TensorXf:
        """(H, W, 3) tensor of Dr.Jit, which NumPy and torch read through DLPack."""
        image = self if self.is_packed else self.packed()
        return self.arrays.plain.TensorXf(image.values, (self.height, self.width, 3))

    def numpy(self) -> NDArray[np.float32]:
        """(H, W, 3) host array; on the CPU a view of the same memory, unless rows are missing."""
        if not self.is_whole:
            return self.packed().numpy()
        rows = np.asarray(self.values).reshape(-1, self.stride, self.channels)
        return rows[: self.height, : self.width, :3]
