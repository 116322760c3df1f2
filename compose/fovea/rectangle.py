"""The rectangle around a disc, in which its pixels form an image."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image

# Shorter runs of pixels are copied pixel by pixel.
_LONG_RUN = 16


@dataclass(frozen=True)
class Rectangle:
    """The rectangle around a disc.

    Attributes:
        box: its rows and columns in the frame.
        shape: (h, w), the number of rows and columns.
        count: D, the number of the disc's pixels.
        spans: runs of adjacent pixels, such as a row of a disc: index of the first one among the D, then
            indices of the first one and of the one after the last among the rectangle's pixels.
    """

    box: tuple[slice, slice]
    shape: tuple[int, int]
    count: int
    spans: list[tuple[int, int, int]]

    @staticmethod
    def around(pixels: NDArray[np.uint32], width: int, height: int) -> Rectangle:
        """The rectangle around (D,) pixels of a frame of that size, D > 0, their indices ascending.

        Its sides are even where the frame allows it, since the fusion judges blocks of 2 x 2 pixels.
        """
        first, start, stop = _runs_of(pixels)
        row, column = np.divmod(start, width)
        last_row, last_column = np.divmod(stop - 1, width)
        rows = _evenly(int(row[0]), int(last_row[-1]) + 1, height)
        if (last_row > row).any():
            # A run that continues in the next row touches both edges of the frame.
            columns = slice(0, width)
        else:
            columns = _evenly(int(column.min()), int(last_column.max()) + 1, width)
        shape = rows.stop - rows.start, columns.stop - columns.start
        begin = (row - rows.start) * shape[1] + column - columns.start
        spans = zip(first.tolist(), begin.tolist(), (begin + stop - start).tolist(), strict=True)
        return Rectangle((rows, columns), shape, len(pixels), list(spans))

    def crop(self, image: Image) -> Image:
        """(h, w, C) part of an image (H, W, C) of the frame."""
        return np.ascontiguousarray(image[self.box])

    def scattered(self, ground: Image, values: NDArray[np.float32]) -> Image:
        """(h, w, C) copy of the ground (h, w, C) with the disc's values (D, C) in it."""
        image = np.array(ground, dtype=np.float32, order="C")
        _scatter(image.reshape(-1, image.shape[2]), self.spans, values)
        return image

    def gathered(self, image: Image) -> NDArray[np.float32]:
        """(D, C) values of the disc's pixels in an image (h, w, C)."""
        flat = image.reshape(-1, image.shape[2])
        values = np.empty((self.count, image.shape[2]), dtype=image.dtype)
        for first, start, stop in self.spans:
            values[first : first + stop - start] = flat[start:stop]
        return values


def scatter(flat: Image, pixels: NDArray[np.uint32], values: NDArray[np.float32]) -> None:
    """Writes values (D, C) to pixels (D,), their indices ascending, of a flat image (N, C)."""
    first, start, stop = _runs_of(pixels)
    long = stop - start >= _LONG_RUN
    _scatter(flat, zip(*(side[long].tolist() for side in (first, start, stop)), strict=True), values)
    single = np.flatnonzero(np.repeat(~long, stop - start))
    flat[pixels[single]] = values.take(single, axis=0)


def _scatter(flat: Image, spans: Iterable[tuple[int, int, int]], values: NDArray[np.float32]) -> None:
    for first, start, stop in spans:
        flat[start:stop] = values[first : first + stop - start]


def _runs_of(pixels: NDArray[np.uint32]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Runs of adjacent pixels, which are copied far faster than single ones.

    Args:
        pixels: (D,) ascending indices.

    Returns:
        (R,) each: index of a run's first pixel among the D, its first pixel, and the one after its last.
    """
    if not len(pixels):
        return (np.zeros(0, dtype=np.int64),) * 3
    first = np.concatenate([[0], np.flatnonzero(np.diff(pixels) != 1) + 1])
    start = pixels[first].astype(np.int64)
    return first, start, start + np.diff(np.append(first, len(pixels)))


def _evenly(start: int, stop: int, end: int) -> slice:
    """From start to stop within 0..end, one longer if that makes it even."""
    if (stop - start) % 2 and stop < end:
        return slice(start, stop + 1)
    if (stop - start) % 2 and start > 0:
        return slice(start - 1, stop)
    return slice(start, stop)
