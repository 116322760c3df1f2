"""Irradiance of a scene's surfaces in cells of several sizes, and what of scattered light it stands for.

Paths that have left what the viewer sees end in it: they take the light that a surface reflects from the
cell that they hit instead of tracing it. Ending paths in hashed cells follows path space filtering (Binder et
al. 2019); that a cell may be no larger than the path's own spread follows neural radiance caching (Müller et
al. 2021, eq. 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from compose.base.arrays import uploaded
from pathtrace.cache.cells import SIDES, Cells, Floats, Grid, Points, cell_names, find
from pathtrace.cache.light_selection import LightChoice, LightSamples
from pathtrace.cache.transport import Transfer

# Density below which directions are not sampled.
_SMALLEST = 1e-20


@dataclass(frozen=True, eq=False)
class IrradianceCache:
    """Irradiance of C cells, by the number of path segments that it took from a light at most."""

    cells: Cells
    # (K, C, 3) linear; [n] is that of at most n + 1 segments, the last that of all.
    irradiance: Floats
    lights: LightChoice  # chances with which paths choose lights
    transfer: Transfer  # what it takes to follow lights that change
    # Share of the work that was done to follow their last change; below 1, some light is an estimate.
    renewed: float = 1.0

    @staticmethod
    def empty(lights: int) -> IrradianceCache:
        """A cache that knows no cell, so that no path ends in it, of a scene with a number of lights."""
        grid = Grid(np.zeros(3, dtype=np.float32), 1.0)
        cells = Cells.of(Points.none(), grid, lambda one, other, side: np.ones(len(one), dtype=bool))
        nothing = np.zeros(0, dtype=np.int64)
        dark = LightSamples(nothing, nothing, np.zeros(0, dtype=np.float32))
        choice = LightChoice.of(dark, Points.none(), grid, lights)
        return IrradianceCache(cells, np.zeros((1, 0, 3), dtype=np.float32), choice, Transfer.none())

    @property
    def bytes(self) -> int:
        """Memory that paths read from; `transfer` takes more."""
        return self.cells.table.names.nbytes + self.cells.table.indices.nbytes + self.irradiance.nbytes

    def arrays(self, scene: mi.Scene) -> CacheArrays:
        """The cache as Dr.Jit arrays, for the Mitsuba scene that it was filled for."""
        steps, cells = (mi.UInt32(size) for size in self.irradiance.shape[:2])
        dr.make_opaque(steps, cells)
        known = self.cells.grid.arrays, self.cells.table.arrays, steps, cells, *self._channels()
        return CacheArrays(known, self.lights.arrays(scene))

    def relit(self, arrays: CacheArrays) -> CacheArrays:
        """The arrays of this cache, given those of the same cells in other light."""
        known, lights = arrays.irradiance[:-3], arrays.lights[:-2]
        return CacheArrays((*known, *self._channels()), (*lights, *self.lights.chance_arrays()))

    def _channels(self) -> list[Any]:
        """Irradiance of each channel; all that changes with the light."""
        # One more value, since kernels cannot read from an empty array.
        channels = (np.append(self.irradiance[..., channel], np.float32(0)) for channel in range(3))
        return [uploaded(mi.Float, values) for values in channels]


@dataclass(frozen=True)
class CacheArrays:
    """An irradiance cache as Dr.Jit arrays for `look_up` and for `Lights`."""

    irradiance: tuple[Any, ...]
    lights: tuple[Any, ...]


def look_up(
    arrays: tuple[Any, ...],
    position: mi.Point3f,
    normal: mi.Normal3f,
    area: mi.Float,
    segments: mi.UInt32,
    jitter: mi.Point2f,
    active: mi.Bool,
) -> tuple[Any, Any]:
    """Mask of the paths that get an answer, and irradiance (Color3f), from the smallest cells that are known.

    Args:
        arrays: of an `IrradianceCache`.
        position, normal: N points and unit normals of the lit side.
        area: (N,) area over which the paths that ask have spread; cells must not be larger.
        segments: (N,) number of segments that these paths may still take, at least 1.
        jitter: N random points in 0..1, which choose neighbouring cells near borders, so that no grid shows.
        active: (N,) mask of the paths that ask.
    """
    (origin, scale), table, steps, cells, *channels = arrays
    frame = mi.Frame3f(normal)
    across = frame.s * (jitter.x - 0.5) + frame.t * (jitter.y - 0.5)
    local = (position - origin) / scale
    spread = area / dr.square(scale)
    known, cell = mi.Bool(False), mi.UInt32(0)
    for level, side in enumerate(SIDES):
        asks = active & (spread >= side * side)
        # Where the neighbour is not known, the cell itself is nearer than a larger one of both.
        for place in (local + across * side, local):
            found, index = find(table, *cell_names(place, normal, level), asks & ~known)
            cell = dr.select(found, index, cell)
            known |= found
    cell += (dr.minimum(segments, steps) - 1) * cells
    return known, mi.Color3f(*(dr.gather(mi.Float, channel, cell, known) for channel in channels))


def irradiance_share(flags: mi.UInt32, wi: mi.Vector3f, wo: mi.Vector3f, pdf: mi.Float) -> mi.Float:
    """Share, 0 to 1, of the light scattered between N pairs of directions that irradiance stands for.

    A cache gives that share, a path or shadow ray the rest, so that a light is counted once in total. It is 1
    where directions are as dense as those of a diffuse surface, falls towards the peaks of glossy lobes, and
    is 0 for mirrors and glass. Treating wide glossy lobes as diffuse was 3 % too bright beside a floor of
    rough metal.

    Given are BSDF flags, directions in the surface's frame, and the density with which the surface samples
    `wo`; 0 for the only direction of a mirror.
    """
    diffuse = mi.has_flag(flags, mi.BSDFFlags.Diffuse) & (wi.z * wo.z > 0)
    even = dr.abs(wo.z) * dr.inv_pi
    share = dr.square(dr.minimum(even / dr.maximum(pdf, _SMALLEST), 1))
    return dr.select(diffuse & (pdf > 0), dr.select(shows_lights(flags), share, 1), 0)


def sampled_share(flags: mi.UInt32, wi: mi.Vector3f, sample: mi.BSDFSample3f) -> mi.Float:
    """`irradiance_share` of N sampled directions, given as Mitsuba BSDF samples."""
    delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
    return irradiance_share(flags, wi, sample.wo, dr.select(delta, 0, sample.pdf))


def shows_lights(flags: mi.UInt32) -> mi.Bool:
    """Whether surfaces have lobes that show what is in some directions; others reflect irradiance only."""
    return (flags & (mi.BSDFFlags.All & ~mi.BSDFFlags.Diffuse)) != 0
