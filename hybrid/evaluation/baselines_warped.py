"""Rectangular mapping-based foveated rendering (RMFR): traces a smaller buffer, densest at the gaze.

Both axes are mapped separately in the same way. With x the offset from the gaze and M the distance from the
gaze to the edge on that side, in fractions of the frame's side, x maps to x (f + M) / (f + |x|) in the buffer
(Ye et al. 2022, as used by Foveated Path Culling). f controls how much of the buffer the surroundings of the
gaze get; sigma is the side of the frame over that of the buffer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.base.compute_device import PassClock
from hybrid.evaluation.baselines_traced import PathTraced
from pathtrace.trace.film import box_positions

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """The mapping along one axis, from `size` pixels of the frame to `buffer` pixels of the buffer.

    The gaze is a position in 0..1. The smaller f, above 0, the more of the buffer goes to the surroundings of
    the gaze.
    """

    gaze: float
    f: float
    size: int
    buffer: int

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
    """The mapping of a frame, along its width (across) and along its height (down)."""

    across: Axis
    down: Axis

    @staticmethod
    def of(gaze: Gaze, width: int, height: int, f: float, sigma: float) -> Warp:
        """The mapping into a buffer with sides smaller by sigma, above 0."""
        sides = ((gaze.x, width), (gaze.y, height))
        return Warp(*(Axis(at, f, size, max(1, round(size / sigma))) for at, size in sides))

    def boxes(self) -> tuple[Array, Array, Array, Array]:
        """(N,) each: left, top, width and height of what buffer pixels cover, in frame pixels."""
        edges = [axis.frame_of(np.arange(axis.buffer + 1.0)) for axis in (self.across, self.down)]
        left, top = np.meshgrid(edges[0][:-1], edges[1][:-1])
        width, height = np.meshgrid(np.diff(edges[0]), np.diff(edges[1]))
        return left.ravel(), top.ravel(), width.ravel(), height.ravel()

    def frame(self, buffer: Image, is_noisy: bool) -> Image:
        """(H, W, 3) the frame of a buffer (rows, columns, 3), by `weights` along each axis; 0 or more."""
        rows, columns, channels = buffer.shape
        tall = weights(self.down, is_noisy) @ buffer.reshape(rows, columns * channels)
        turned = tall.reshape(-1, columns, channels).transpose(1, 0, 2).reshape(columns, -1)
        frame = (weights(self.across, is_noisy) @ turned).reshape(self.across.size, -1, channels)
        # Weights below 0 overshoot at edges.
        return np.ascontiguousarray(np.maximum(frame, 0).transpose(1, 0, 2))


def weights(axis: Axis, is_noisy: bool) -> sparse.csr_array:
    """(size, buffer) sparse float32 weights of the buffer's pixels in those of the frame, which add up to 1.

    A filter as wide as a pixel of the buffer, or of the frame where that is larger: Catmull and Rom's cubic
    one (1974), which is sharp, or for noisy buffers a Gaussian one. The border is repeated.
    """
    edges = axis.buffer_of(np.arange(axis.size + 1.0))
    centres = axis.buffer_of(np.arange(float(axis.size)) + 0.5)
    width = np.maximum(np.diff(edges), 1)
    first = np.floor(centres - 2 * width).astype(np.int64)  # (size,)
    taps = first[:, None] + np.arange(int(np.ceil(4 * width.max())) + 1)  # (size, K) pixels of the buffer
    found = (_gaussian if is_noisy else _cubic)((taps + 0.5 - centres[:, None]) / width[:, None])
    found /= found.sum(axis=1, keepdims=True)
    row = np.repeat(np.arange(axis.size), taps.shape[1])
    column = np.clip(taps, 0, axis.buffer - 1).ravel()
    # What falls on the same pixel at the border adds up.
    return sparse.csr_array((found.ravel().astype(np.float32), (row, column)), shape=(axis.size, axis.buffer))


def _cubic(offset: Array) -> Array:
    """Catmull and Rom's filter at offsets in pixels; 0 from 2 on."""
    x = np.minimum(np.abs(offset), 2)
    return np.where(x < 1, 1.5 * x**3 - 2.5 * x**2 + 1, -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2)


def _gaussian(offset: Array) -> Array:
    """A Gaussian filter of standard deviation 1/2 at offsets in pixels; 0 from 2 on."""
    return np.where(np.abs(offset) < 2, np.exp(-2 * offset**2), 0)


@dataclass(frozen=True)
class Rmfr(PathTraced):
    """RMFR: traces a smaller buffer, densest at the gaze, denoised before it is mapped back to the frame."""

    f: float
    sigma: float

    @property
    def settings(self) -> dict[str, Any]:
        return {"spp": self.spp, "f": self.f, "sigma": self.sigma, "denoised": str(self.denoised).lower()}

    def rays(self, camera: Camera, gaze: Gaze) -> float:
        warp = self._warp(camera, gaze)
        return self.spp * warp.across.buffer * warp.down.buffer / (camera.width * camera.height)

    def _image(self, camera: Camera, gaze: Gaze, seed: int, clock: PassClock) -> Image:
        warp = self._warp(camera, gaze)
        positions, columns = box_positions(*warp.boxes()), warp.across.buffer
        image = warp.frame(self.traced(camera, positions, columns, seed, clock), not self.denoised)
        clock.lap("enlarge")
        return image

    def _warp(self, camera: Camera, gaze: Gaze) -> Warp:
        return Warp.of(gaze, camera.width, camera.height, self.f, self.sigma)
