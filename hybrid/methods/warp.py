"""Rectangular mapping of a frame into a smaller buffer, densest at the gaze (RMFR): a peer to compare with.

Both axes are mapped alike and apart from each other. With x the offset from the gaze and M the distance from
the gaze to the edge on that side, in fractions of the frame's side, the buffer has x at x (f + M) / (f + |x|)
(Ye et al. 2022, as Foveated Path Culling uses it). f says how much of the buffer the gaze gets, sigma how
much smaller than the frame the buffer is on each side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.eye.gaze import Gaze
from compose.image.colour import Image

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """The mapping along one side of a frame.

    Attributes:
        gaze: in 0..1.
        f: more than 0; the smaller, the more of the buffer the gaze gets.
        size, buffer: pixels of the frame and of the buffer.
    """

    gaze: float
    f: float
    size: int
    buffer: int

    def __post_init__(self) -> None:
        if not 0 <= self.gaze <= 1:
            raise ValueError(f"gaze {self.gaze} lies outside of the frame")
        if not (np.isfinite(self.f) and self.f > 0) or min(self.size, self.buffer) < 1:
            raise ValueError(f"f {self.f} and {self.buffer} of {self.size} pixels are no mapping")

    def buffer_of(self, pixels: Array) -> Array:
        """Buffer coordinates, in pixels, of frame coordinates."""
        offset = pixels / self.size - self.gaze
        return (self.gaze + offset * (self.f + self._far(offset)) / (self.f + np.abs(offset))) * self.buffer

    def frame_of(self, pixels: Array) -> Array:
        """Frame coordinates, in pixels, of buffer coordinates."""
        offset = pixels / self.buffer - self.gaze
        return (self.gaze + self.f * offset / (self.f + self._far(offset) - np.abs(offset))) * self.size

    def _far(self, offset: Array) -> Array:
        return np.where(offset < 0, self.gaze, 1 - self.gaze)


@dataclass(frozen=True)
class Warp:
    """The mapping of a frame.

    Attributes:
        across, down: along its width and its height.
    """

    across: Axis
    down: Axis

    @staticmethod
    def of(gaze: Gaze, width: int, height: int, f: float, sigma: float) -> Warp:
        """That of a frame of so many pixels into a buffer with sides smaller by sigma.

        Raises:
            ValueError: the gaze lies outside of the frame, or f or sigma is not positive.
        """
        if not (np.isfinite(sigma) and sigma > 0):
            raise ValueError(f"sigma {sigma} must be positive")
        sides = ((gaze.x, width), (gaze.y, height))
        return Warp(*(Axis(at, f, size, max(1, round(size / sigma))) for at, size in sides))

    def boxes(self) -> tuple[Array, Array, Array, Array]:
        """Left and upper edges, widths and heights, in frame pixels, of what each pixel of the buffer covers.

        (N,) each, row by row.
        """
        edges = [axis.frame_of(np.arange(axis.buffer + 1.0)) for axis in (self.across, self.down)]
        left, top = np.meshgrid(edges[0][:-1], edges[1][:-1])
        width, height = np.meshgrid(np.diff(edges[0]), np.diff(edges[1]))
        return left.ravel(), top.ravel(), width.ravel(), height.ravel()

    def frame(self, buffer: Image) -> Image:
        """(H, W, 3) the frame that a buffer shows, linear between its pixels."""
        rows, columns = _between(self.down), _between(self.across)
        mixed = buffer[rows[0]] * (1 - rows[2])[:, None, None] + buffer[rows[1]] * rows[2][:, None, None]
        across = columns[2][None, :, None]
        return np.asarray(
            mixed[:, columns[0]] * (1 - across) + mixed[:, columns[1]] * across, dtype=np.float32
        )


def _between(axis: Axis) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """For each pixel of the frame the two of the buffer beside its centre, and how near the second is."""
    centres = np.arange(axis.size, dtype=np.float64) + 0.5
    place = np.clip(axis.buffer_of(centres) - 0.5, 0, axis.buffer - 1)
    first = np.minimum(place.astype(np.int64), max(0, axis.buffer - 2))
    return first, np.minimum(first + 1, axis.buffer - 1), (place - first).astype(np.float32)
