"""The disc that is path-traced, the part of it that is not rasterized, and the band between their edges.

Radii are in percent of the frame's height, measured in pixels on the screen (Foveated Path Culling,
section 3): the path tracer covers r < fov-a, the splats cover r > fov-b, the weight is linear between. Once
fov-a reaches the frame's furthest pixel, what weight is left to the splats fades out, as fov-a grows by
another fifth: then the frame is path-traced as a whole. So weights are continuous in radii and gaze.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from compose.fovea.rectangle import Rectangle

# Radius of a disc that leaves no splats, whatever fov-b is, over the distance of the furthest pixel.
_WHOLE = 1.2
# Narrowest band in pixels: thinner ones are edges, and float32 could not divide by their widths.
_THINNEST = 1e-6


@dataclass(frozen=True)
class Foveation:
    """Where the viewer looks and how large the fovea is.

    Attributes:
        gaze: in fractions of the frame.
        fov_a: outer radius in percent of the height; 0 traces nothing.
        fov_b: inner radius in percent of the height; no splats are visible inside it.

    Raises:
        UserError: a radius is negative or not finite, or fov-b is larger than fov-a.
    """

    gaze: Gaze
    fov_a: float = 20.0
    fov_b: float = 15.0

    def __post_init__(self) -> None:
        for name, value in (("fov-a", self.fov_a), ("fov-b", self.fov_b)):
            if not np.isfinite(value) or value < 0:
                raise UserError(f"{name} {value}: must be a percentage of the height, 0 or more")
        if self.fov_b > self.fov_a:
            raise UserError(
                f"fov-b {self.fov_b}: must be at most fov-a {self.fov_a}, because it is the inner radius"
            )

    def region(self, width: int, height: int) -> FoveaRegion:
        """The pixels and weights of this foveation on a frame of that size in pixels."""
        gaze_x, gaze_y = self.gaze.pixel(width, height)
        outer, inner = self.fov_a / 100 * height, self.fov_b / 100 * height
        across, down = (max(at, side - at) - 0.5 for at, side in ((gaze_x, width), (gaze_y, height)))
        furthest = float(np.hypot(across, down))
        if outer > 0 and (outer >= _WHOLE * furthest or inner >= furthest):
            # No periphery is left to blend with.
            pixels = np.arange(width * height, dtype=np.uint32)
            weights = np.ones(len(pixels), dtype=np.float32)
        else:
            pixels, radius = _disc(gaze_x, gaze_y, outer, width, height)
            band = outer - inner
            weights = np.clip((outer - radius) / band, 0, 1) if band > _THINNEST else np.ones_like(radius)
            if outer > furthest:
                faded = (outer - furthest) / ((_WHOLE - 1) * furthest)
                weights += (1 - weights) * np.float32(faded)
        return FoveaRegion(width, height, pixels, weights, (gaze_x, gaze_y), inner)


@dataclass(frozen=True)
class FoveaRegion:
    """The pixels of a frame that the fovea covers.

    Attributes:
        width, height: frame in pixels.
        pixels: (D,) row-major indices of the pixels to path-trace.
        weights: (D,) weight of the path-traced radiance in each of them, 0..1; it is 0 in all other pixels.
        centre: (x, y) of the disc in pixels.
        inner: radius in pixels inside which no splats are visible.
    """

    width: int
    height: int
    pixels: NDArray[np.uint32]
    weights: NDArray[np.float32]
    centre: tuple[float, float]
    inner: float

    @cached_property
    def covers_frame(self) -> bool:
        """Whether no periphery is left."""
        return len(self.pixels) == self.width * self.height and bool((self.weights == 1).all())

    def weight_image(self) -> NDArray[np.float32]:
        """(H, W) weight of the path-traced radiance; the weight of the splats is one minus it."""
        image = np.zeros(self.width * self.height, dtype=np.float32)
        image[self.pixels] = self.weights
        return image.reshape(self.height, self.width)

    def image_of(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W, C) image of the region's values (D, C), 0 elsewhere."""
        image = np.zeros((self.height * self.width, values.shape[1]), dtype=np.float32)
        image[self.pixels] = values
        return image.reshape(self.height, self.width, -1)

    @cached_property
    def rectangle(self) -> Rectangle:
        """The rectangle around the disc, which must have a pixel."""
        return Rectangle.around(self.pixels, self.width, self.height)

    def foveal_tiles(self, tile: int) -> NDArray[np.bool_]:
        """(rows, columns) bool: tiles that overlap the rectangle around the disc, `tile` pixels per side."""
        tiles = np.zeros((-(-self.height // tile), -(-self.width // tile)), dtype=bool)
        if len(self.pixels):
            rows, columns = self.rectangle.box
            down, across = (slice(s.start // tile, -(-s.stop // tile)) for s in (rows, columns))
            tiles[down, across] = True
        return tiles

    def peripheral_tiles(self, tile: int) -> NDArray[np.bool_]:
        """(rows, columns) bool: tiles with a pixel in which splats are visible, `tile` pixels per side."""
        if self.covers_frame:
            return np.zeros((-(-self.height // tile), -(-self.width // tile)), dtype=bool)
        # A tile is hidden if its pixel furthest from the centre is.
        y, x = (
            np.maximum(np.abs(first + 0.5 - middle), np.abs(np.minimum(first + tile, size) - 0.5 - middle))
            for size, middle in ((self.height, self.centre[1]), (self.width, self.centre[0]))
            for first in (np.arange(0, size, tile),)
        )
        return np.hypot(y[:, None], x[None, :]) >= self.inner


def _disc(
    x: float, y: float, radius: float, width: int, height: int
) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Row-major indices (D,) of the pixels whose centres lie within a radius, and their distances (D,).

    It works row by row, because a frame has many times the disc's pixels.
    """
    first, stop = _span(y, np.float64(radius), height)
    down = np.arange(first, stop) + 0.5 - y
    starts, stops = _span(x, np.sqrt(np.maximum(radius**2 - down**2, 0)), width)
    counts = np.maximum(stops - starts, 0)
    # int32 instead of numpy's int64: memory bandwidth limits this.
    before = (np.cumsum(counts) - counts).astype(np.int32)
    column = np.arange(counts.sum(), dtype=np.int32) - np.repeat(before - starts.astype(np.int32), counts)
    pixels = column + np.repeat(np.arange(first, stop, dtype=np.int32) * width, counts)
    across = column.astype(np.float32) + np.float32(0.5 - x)
    radius_squared = across**2 + np.repeat((down**2).astype(np.float32), counts)
    return pixels.view(np.uint32), np.sqrt(radius_squared)


def _span(centre: float, half: Any, size: int) -> tuple[Any, Any]:
    """First pixel of an axis whose centre lies within `half` of a position, and the one after the last."""
    ends = np.floor(centre - half - 0.5) + 1, np.ceil(centre + half - 0.5)
    first, stop = (np.clip(end, 0, size).astype(np.int64) for end in ends)
    return first, stop
