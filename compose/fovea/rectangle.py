"""The rectangle around a disc, in which its pixels are an image."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
# Shorter runs of pixels are copied pixel by pixel.
_LONG_RUN = 16


@dataclass(frozen=True)
class Rectangle:
    """The rectangle around a disc.

    Attributes:
        box: its rows and columns.
        shape: how many they are.
        count: D, the disc's pixels.
        spans: runs of pixels side by side; a row of a disc is one. First of each run among the D, then its
            first and its end among the rectangle's pixels.
    """

    box: tuple[slice, slice]
    shape: tuple[int, int]
    count: int
    spans: list[tuple[int, int, int]]

    @staticmethod
    def around(pixels: NDArray[np.uint32], width: int, height: int) -> Rectangle:
        """That of (D,) pixels of a frame of that size, at least one, in the order of their indices.

        Its sides are even where the frame allows it, since fusing looks at blocks of 2 x 2 pixels.
        """
        first, start, stop = _runs_of(pixels)
        row, column = np.divmod(start, width)
        last_row, last_column = np.divmod(stop - 1, width)
        rows = _evenly(int(row[0]), int(last_row[-1]) + 1, height)
        if (last_row > row).any():
            # A run that goes on in the next row has seen both ends of a row.
            columns = slice(0, width)
        else:
            columns = _evenly(int(column.min()), int(last_column.max()) + 1, width)
        shape = rows.stop - rows.start, columns.stop - columns.start
        place = (row - rows.start) * shape[1] + column - columns.start
        spans = zip(first.tolist(), place.tolist(), (place + stop - start).tolist(), strict=True)
        return Rectangle((rows, columns), shape, len(pixels), list(spans))

    def crop(self, image: Image) -> Image:
        """(h, w, C) of an image of the frame."""
        return np.ascontiguousarray(image[self.box])

    def scattered(self, ground: Image, values: NDArray[np.float32]) -> Image:
        """(h, w, C): the disc's values (D, C) on a ground (h, w, C)."""
        image = np.array(ground, dtype=np.float32, order="C")
        _scatter(image.reshape(-1, image.shape[2]), self.spans, values)
        return image

    def taken(self, image: Image) -> NDArray[np.float32]:
        """(D, C): the disc's values of an image (h, w, C)."""
        flat = image.reshape(-1, image.shape[2])
        values = np.empty((self.count, image.shape[2]), dtype=image.dtype)
        for first, start, stop in self.spans:
            values[first : first + stop - start] = flat[start:stop]
        return values


def scatter(flat: Image, pixels: NDArray[np.uint32], values: NDArray[np.float32]) -> None:
    """Writes values (D, C) into pixels (D,), in the order of their indices, of a flat image (N, C)."""
    first, start, stop = _runs_of(pixels)
    long = stop - start >= _LONG_RUN
    _scatter(flat, zip(*(side[long].tolist() for side in (first, start, stop)), strict=True), values)
    single = np.flatnonzero(np.repeat(~long, stop - start))
    flat[pixels[single]] = values.take(single, axis=0)


def _scatter(flat: Image, spans: Iterable[tuple[int, int, int]], values: NDArray[np.float32]) -> None:
    for first, start, stop in spans:
        flat[start:stop] = values[first : first + stop - start]


def _runs_of(pixels: NDArray[np.uint32]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Runs of pixels side by side, which are copied far quicker than single ones.

    Args:
        pixels: (D,) indices in ascending order.

    Returns:
        (R,) each: first of a run among the D, its first pixel, and the one after its last.
    """
    if not len(pixels):
        return (np.zeros(0, dtype=np.int64),) * 3
    first = np.concatenate([[0], np.flatnonzero(np.diff(pixels) != 1) + 1])
    start = pixels[first].astype(np.int64)
    return first, start, start + np.diff(np.append(first, len(pixels)))


def _evenly(start: int, stop: int, end: int) -> slice:
    """From start to stop within 0..end, one further if that makes it even."""
    if (stop - start) % 2 and stop < end:
        return slice(start, stop + 1)
    if (stop - start) % 2 and start > 0:
        return slice(start - 1, stop)
    return slice(start, stop)
