"""The mapping of rectangular mapping-based foveated rendering (RMFR): a smaller buffer, densest at the gaze.

Both axes are mapped separately in the same way. With x the offset from the gaze and M the distance from the
gaze to the edge on that side, in fractions of the frame's side, x maps to x (f + M) / (f + |x|) in the buffer
(Ye et al. 2022, as used by Foveated Path Culling). f controls how much of the buffer the surroundings of the
gaze get; sigma is the side of the frame over that of the buffer.
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
    """The mapping along one axis.

    Attributes:
        gaze: position in 0..1.
        f: above 0; the smaller, the more of the buffer goes to the surroundings of the gaze.
        size, buffer: pixels of the frame and of the buffer.

    Raises:
        ValueError: the gaze lies outside the frame, f is not positive, or a side has no pixel.
    """

    gaze: float
    f: float
    size: int
    buffer: int

    def __post_init__(self) -> None:
        if not 0 <= self.gaze <= 1:
            raise ValueError(f"gaze {self.gaze} lies outside the frame")
        if not (np.isfinite(self.f) and self.f > 0) or min(self.size, self.buffer) < 1:
            raise ValueError(f"f {self.f}, buffer {self.buffer}, size {self.size}: all must be positive")

    def buffer_of(self, pixels: Array) -> Array:
        """(N,) buffer coordinates in pixels, of frame coordinates (N,) in pixels."""
        offset = pixels / self.size - self.gaze
        return (self.gaze + offset * (self.f + self._far(offset)) / (self.f + np.abs(offset))) * self.buffer

    def frame_of(self, pixels: Array) -> Array:
        """(N,) frame coordinates in pixels, of buffer coordinates (N,) in pixels."""
        offset = pixels / self.buffer - self.gaze
        return (self.gaze + self.f * offset / (self.f + self._far(offset) - np.abs(offset))) * self.size

    def _far(self, offset: Array) -> Array:
        """Distance from the gaze to the edge on the side of an offset."""
        return np.where(offset < 0, self.gaze, 1 - self.gaze)


@dataclass(frozen=True)
class Warp:
    """The mapping of a frame.

    Attributes:
        across, down: along its width and along its height.
    """

    across: Axis
    down: Axis

    @staticmethod
    def of(gaze: Gaze, width: int, height: int, f: float, sigma: float) -> Warp:
        """The mapping of a frame of that size in pixels into a buffer with sides smaller by sigma.

        Raises:
            ValueError: the gaze lies outside the frame, or f or sigma is not positive.
        """
        if not (np.isfinite(sigma) and sigma > 0):
            raise ValueError(f"sigma {sigma} must be positive")
        sides = ((gaze.x, width), (gaze.y, height))
        return Warp(*(Axis(at, f, size, max(1, round(size / sigma))) for at, size in sides))

    def boxes(self) -> tuple[Array, Array, Array, Array]:
        """What each of the N buffer pixels covers of the frame, in frame pixels, row by row.

        Returns:
            Left edges, top edges, widths and heights, (N,) each.
        """
        edges = [axis.frame_of(np.arange(axis.buffer + 1.0)) for axis in (self.across, self.down)]
        left, top = np.meshgrid(edges[0][:-1], edges[1][:-1])
        width, height = np.meshgrid(np.diff(edges[0]), np.diff(edges[1]))
        return left.ravel(), top.ravel(), width.ravel(), height.ravel()

    def frame(self, buffer: Image) -> Image:
        """(H, W, 3) the frame of a buffer (rows, columns, 3), interpolated linearly."""
        rows, columns = _between(self.down), _between(self.across)
        mixed = buffer[rows[0]] * (1 - rows[2])[:, None, None] + buffer[rows[1]] * rows[2][:, None, None]
        across = columns[2][None, :, None]
        return np.asarray(
            mixed[:, columns[0]] * (1 - across) + mixed[:, columns[1]] * across, dtype=np.float32
        )


def _between(axis: Axis) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """The two buffer pixels beside the centre of each frame pixel, and the second one's weight.

    Returns:
        First pixels, second pixels and weights, (size,) each.
    """
    centres = np.arange(axis.size, dtype=np.float64) + 0.5
    position = np.clip(axis.buffer_of(centres) - 0.5, 0, axis.buffer - 1)
    first = np.minimum(position.astype(np.int64), max(0, axis.buffer - 2))
    return first, np.minimum(first + 1, axis.buffer - 1), (position - first).astype(np.float32)
