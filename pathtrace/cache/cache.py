"""Irradiance of a scene's surfaces in a hash table of cells of several sizes.

Paths that have left what the viewer sees end in it: they take the light that a surface reflects from the
cell that they hit instead of tracing it. Ending paths in hashed cells follows path space filtering (Binder et
al. 2019); that a cell may be no larger than the path's own spread follows neural radiance caching (Müller et
al. 2021, eq. 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from pathtrace.cache.cells import SIDES, Cells, cell_names_jit

# Places in the table that are searched for a cell, from the one that its first name selects on.
_PROBES = 4
# Places in the table for each cell, at least.
_ROOM = 3


@dataclass(frozen=True, eq=False)
class IrradianceCache:
    """Irradiance of C cells, by the number of path segments that it took from a light at most.

    A path that has few segments left gets the light of few segments, as one that was traced on would.

    Attributes:
        cells: the cells.
        irradiance: (K, C, 3) linear; [n] is that of at most n + 1 segments, the last that of all.
    """

    cells: Cells
    irradiance: NDArray[np.float32]

    @property
    def bytes(self) -> int:
        """Memory that it takes."""
        return 8 * len(self._table[0]) + self.irradiance.nbytes

    @cached_property
    def _table(self) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        return _table(*self.cells.names)

    @cached_property
    def arrays(self) -> tuple[Any, ...]:
        """The cache as Dr.Jit arrays for `look_up`."""
        origin, scale = mi.Point3f(*self.cells.origin.tolist()), mi.Float(self.cells.scale)
        steps, cells = (mi.UInt32(size) for size in self.irradiance.shape[:2])
        dr.make_opaque(origin, scale, steps, cells)
        channels = (mi.Float(self.irradiance[..., channel].ravel()) for channel in range(3))
        return origin, scale, steps, cells, *(mi.UInt32(part) for part in self._table), *channels


def look_up(
    arrays: tuple[Any, ...],
    position: Any,
    normal: Any,
    area: Any,
    segments: Any,
    jitter: Any,
    active: Any,
) -> tuple[Any, Any]:
    """Irradiance at surface points, from the smallest cells that are known.

    Args:
        arrays: of an `IrradianceCache`.
        position, normal: N Mitsuba points and unit normals of the lit side.
        area: (N,) area over which the paths that ask have spread; cells must not be larger.
        segments: (N,) number of segments that these paths may still take, at least 1.
        jitter: N random points in 0..1: neighbouring cells are chosen by chance near their borders, so that
            the grid does not show.
        active: (N,) mask of the paths that ask.

    Returns:
        Mask of the paths that got an answer, and their irradiance (Color3f, 0 elsewhere).
    """
    origin, scale, steps, cells, names, indices, *channels = arrays
    last = dr.width(names) - 1
    frame = mi.Frame3f(normal)
    across = frame.s * (jitter.x - 0.5) + frame.t * (jitter.y - 0.5)
    local = (position - origin) / scale
    spread = area / dr.square(scale)
    known, place = mi.Bool(False), mi.UInt32(0)
    for level, side in enumerate(SIDES):
        first, second = cell_names_jit(local + across * side, normal, level)
        fits = active & (spread >= side * side)
        for probe in range(_PROBES):
            here = (first + probe) & last
            asks = fits & ~known
            found = asks & (dr.gather(mi.UInt32, names, here, asks) == second)
            place = dr.select(found, here, place)
            known |= found
    cell = dr.gather(mi.UInt32, indices, place, known)
    cell += (dr.minimum(segments, steps) - 1) * cells
    return known, mi.Color3f(*(dr.gather(mi.Float, channel, cell, known) for channel in channels))


def _table(
    first: NDArray[np.uint32], second: NDArray[np.uint32]
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Hash table of cells with open addressing: (T,) second names and indices; T is a power of two."""
    size = 1 << max(4, int(np.ceil(np.log2(_ROOM * len(first) + 1))))
    while True:
        names, indices = np.zeros(size, np.uint32), np.zeros(size, np.uint32)
        waiting = np.arange(len(first))
        for probe in range(_PROBES):
            here = (first[waiting].astype(np.int64) + probe) & (size - 1)
            # Of the cells that want the same place, the first gets it.
            _, winner = np.unique(here, return_index=True)
            winner = winner[names[here[winner]] == 0]
            names[here[winner]] = second[waiting[winner]]
            indices[here[winner]] = waiting[winner]
            waiting = np.delete(waiting, winner)
        if not len(waiting):
            return names, indices
        size *= 2
