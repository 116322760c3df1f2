"""Foveation: the disc that is path-traced, the part of it that is not rasterized, and the band between.

Radii are in percent of the frame's height, measured in pixels on the screen (Foveated Path Culling, section
3): the path tracer covers r < fov-a, the splats cover r > fov-b, the weight is linear between. Once fov-a
reaches the frame's furthest pixel, what weight is left to the splats fades out as fov-a grows by another
fifth; from then on the whole frame is path-traced. So weights are continuous in radii and gaze.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.eye.gaze import Gaze

if TYPE_CHECKING:
    from compose.base.arrays import Arrays
    from compose.fovea.disc import Disc

# Radius of a disc that leaves no splats, whatever fov-b is, over the distance of the furthest pixel.
_WHOLE = 1.2
# Narrowest band in pixels: thinner ones are edges, and float32 could not divide by their widths.
_THINNEST = 1e-6


class FoveaMode(Enum):
    """How a fovea is made from path-traced samples."""

    RAW = "raw"  # their mean, unbiased
    DENOISED = "denoised"  # their mean, denoised
    FUSED = "fused"  # one estimate from samples, denoised samples and the splats under the disc


class Placement(Enum):
    """Where in a frame paths are traced."""

    DISC = "disc"  # around the gaze
    WHERE_NEEDED = "where-needed"  # in the cells of the frame in which splats are visibly wrong


@dataclass(frozen=True)
class Foveation:
    """Where the viewer looks and how large the fovea is; UserError if a radius is out of its range.

    Attributes:
        gaze: in fractions of the frame.
        fov_a: outer radius in percent of the height, 0 or more; 0 traces nothing.
        fov_b: inner radius in percent of the height, from 0 to fov_a; no splats are visible inside it.
    """

    gaze: Gaze
    fov_a: float = 20.0
    fov_b: float = 15.0

    def __post_init__(self) -> None:
        for name, value in (("fov-a", self.fov_a), ("fov-b", self.fov_b)):
            if not np.isfinite(value) or value < 0:
                raise UserError(f"{name} {value}: must be a percentage of the height, 0 or more")
        if self.fov_b > self.fov_a:
            most = f"at most fov-a {self.fov_a}, because it is the inner radius"
            raise UserError(f"fov-b {self.fov_b}: must be {most}")

    def region(self, width: int, height: int) -> FoveaRegion:
        """The pixels and weights of this foveation on a frame of that size in pixels."""
        x, y = self.gaze.pixel(width, height)
        outer, inner = self.fov_a / 100 * height, self.fov_b / 100 * height
        across, down = (max(at, side - at) - 0.5 for at, side in ((x, width), (y, height)))
        furthest = float(np.hypot(across, down))
        # No periphery is left to blend with.
        whole = outer > 0 and (outer >= _WHOLE * furthest or inner >= furthest)
        fades = outer > furthest and not whole
        faded = (outer - furthest) / ((_WHOLE - 1) * furthest) if fades else 0.0
        return FoveaRegion(width, height, (x, y), inner, outer, whole, faded)


@dataclass(frozen=True)
class FoveaRegion:
    """The pixels of a frame that the fovea covers."""

    width: int  # of the frame, in pixels
    height: int
    centre: tuple[float, float]  # (x, y) of the disc in pixels
    inner: float  # radius in pixels inside which no splats are visible
    outer: float  # radius in pixels of the disc
    covers_frame: bool = False  # whether no periphery is left
    faded: float = 0.0  # share of the splats' weight that is left out

    @cached_property
    def _rows(self) -> _Rows:
        # Work that grows with the frame's height only.
        radius, (x, y) = np.array(np.inf if self.covers_frame else self.outer), self.centre
        top, stop = _span(y, radius, self.height)
        down_squared = (np.arange(int(top), int(stop)) + 0.5 - y) ** 2
        starts, stops = _span(x, np.sqrt(np.maximum(radius**2 - down_squared, 0)), self.width)
        counts = np.maximum(stops - starts, 0)
        used = np.flatnonzero(counts)
        # Rows without a pixel, at the ends only, are left out.
        rows = slice(int(used[0]), int(used[-1]) + 1) if len(used) else slice(0, 0)
        return _Rows(int(top) + rows.start, starts[rows], counts[rows], down_squared[rows])

    @cached_property
    def count(self) -> int:
        """D, the number of the disc's pixels."""
        return int(self._rows.counts.sum())

    @cached_property
    def pixels(self) -> NDArray[np.uint32]:
        """(D,) row-major indices of the pixels, in host memory."""
        rows = self._rows
        first = (rows.top + np.arange(len(rows.starts))) * self.width + rows.starts
        first -= np.cumsum(rows.counts) - rows.counts
        return (np.arange(self.count) + np.repeat(first, rows.counts)).astype(np.uint32)

    def weight_image(self) -> NDArray[np.float32]:
        """(H, W) weight of the path-traced radiance, in host memory; that of the splats is one minus it."""
        image = np.zeros(self.width * self.height, dtype=np.float32)
        row, column = np.divmod(self.pixels, np.uint32(self.width))
        radius = np.hypot(column + np.float32(0.5 - self.centre[0]), row + np.float32(0.5 - self.centre[1]))
        outer, slope = self._slope
        weight = 1.0 if self.covers_frame else np.clip((outer - radius) * slope, 0, 1)
        image[self.pixels] = weight + (1 - weight) * self.faded
        return image.reshape(self.height, self.width)

    @property
    def _slope(self) -> tuple[float, float]:
        """Radius at which the weight is 0, and by how much it rises per pixel towards the centre."""
        band = self.outer - self.inner
        return (self.outer, 1 / band) if band > _THINNEST else (np.inf, 1.0)

    @property
    def box(self) -> tuple[slice, slice]:
        """Rows and columns of the rectangle around the disc, which must have a pixel.

        Its sides are even where the frame allows it, since the fusion judges blocks of 2 x 2 pixels.
        """
        rows = self._rows
        down = _evenly(rows.top, rows.top + len(rows.starts), self.height)
        return down, _evenly(int(rows.starts.min()), int((rows.starts + rows.counts).max()), self.width)

    def disc(self, arrays: Arrays) -> Disc:
        """The pixels and their weights on the device."""
        # Only now: code that only says where the fovea is need not load Dr.Jit.
        from compose.fovea.disc import Disc

        return Disc.in_region(arrays, self)

    def table(self) -> tuple[NDArray[np.uint32], int]:
        """What a kernel needs to list the pixels of a region with some that does not cover the frame; and P.

        P is a power of two that is at least the number of rows. Numbers of pixels above each of P rows, first
        columns of P rows, the first row, the frame's width; and as bits of float32 squared distances of P
        rows from the centre, the centre of column 0 as seen from there, the radius at which the weight is 0,
        its slope per pixel, and what is left out of the splats' weight.
        """
        rows = self._rows
        size = 1 << max(len(rows.starts) - 1, 63).bit_length()
        fill = 0, size - len(rows.starts)
        before = np.pad(np.cumsum(rows.counts) - rows.counts, fill, constant_values=self.count)
        integers = np.concatenate([before, np.pad(rows.starts, fill), [rows.top, self.width]])
        numbers = [0.5 - self.centre[0], *self._slope, self.faded]
        floats = np.concatenate([np.pad(rows.down_squared, fill), numbers]).astype(np.float32)
        return np.concatenate([integers.astype(np.uint32), floats.view(np.uint32)]), size

    def foveal_tiles(self, tile: int) -> NDArray[np.bool_]:
        """(rows, columns) bool: tiles that overlap the rectangle around the disc, `tile` pixels per side."""
        tiles = np.zeros((-(-self.height // tile), -(-self.width // tile)), dtype=bool)
        if self.count:
            down, across = (slice(s.start // tile, -(-s.stop // tile)) for s in self.box)
            tiles[down, across] = True
        return tiles

    def peripheral_tiles(self, tile: int) -> NDArray[np.bool_]:
        """(rows, columns) bool: tiles with a pixel in which splats are visible, `tile` pixels per side."""
        # A tile is hidden if its pixel furthest from the centre is.
        y, x = (
            np.maximum(np.abs(first + 0.5 - middle), np.abs(np.minimum(first + tile, size) - 0.5 - middle))
            for size, middle in ((self.height, self.centre[1]), (self.width, self.centre[0]))
            for first in (np.arange(0, size, tile),)
        )
        return (np.hypot(y[:, None], x[None, :]) >= self.inner) & (not self.covers_frame)


class _Rows(NamedTuple):
    """Pixels of a disc in R rows."""

    top: int
    starts: NDArray[np.int64]  # (R,), first columns
    counts: NDArray[np.int64]  # (R,)
    down_squared: NDArray[np.floating]  # (R,), distance of the row from the centre


def _span(
    centre: float, half: NDArray[np.floating], size: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First pixel of an axis whose centre lies within `half` of a position, and the one after the last."""
    ends = np.floor(centre - half - 0.5) + 1, np.ceil(centre + half - 0.5)
    first, stop = (np.clip(end, 0, size).astype(np.int64) for end in ends)
    return first, stop


def _evenly(start: int, stop: int, end: int) -> slice:
    """From start to stop within 0..end, one longer if that makes it even."""
    if (stop - start) % 2 == 0:
        return slice(start, stop)
    return slice(start, stop + 1) if stop < end else slice(max(start - 1, 0), stop)
