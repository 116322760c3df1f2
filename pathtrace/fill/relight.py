"""Follows lights that change: their light is sampled anew, part by part, and passed on along known links.

Only what lights send changes with them. What surfaces do with light stays as the cache was filled with it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pathtrace.cache.cache import IrradianceCache
from pathtrace.cache.renewal import Renewal
from pathtrace.cache.spreading import Spreading
from pathtrace.fill.resampling import Part, Resampling
from pathtrace.fill.segments import segments_beyond_cache
from pathtrace.scene.scene import Scene

# Updates in which all points and rays are sampled anew.
PARTS = 12


class Relighting:
    """The light of a cache, kept up to date with the lights of its scene, which have just changed.

    Args:
        scene: that the cache was filled for.
        cache: all of whose light is known, with at least one cell.
        seed: same seed, same light on the same machine.
    """

    def __init__(self, scene: Scene, cache: IrradianceCache, seed: int = 0):
        self._transfer, self._cache = cache.transfer, cache
        self._resampling = Resampling(scene.mitsuba, cache.transfer, PARTS, seed)
        self._cells = np.flatnonzero(cache.transfer.known)
        self._most = segments_beyond_cache(scene)
        self._rows = cache.lights.rows(cache.transfer.points)
        regions = self._transfer.transport.patches.regions
        self._direct = Renewal(self._transfer.direct, self._transfer.numbers, regions)
        count = len(self._transfer.reflected)
        rays = np.bincount(self._transfer.ray_regions, minlength=count)
        self._reflected = Renewal(self._transfer.reflected, rays, np.zeros(count, dtype=np.int64))
        self._begin()

    def change(self) -> None:
        """Says that the lights changed again: all that is known of them is old now."""
        self._direct, self._reflected = self._direct.again(), self._reflected.again()
        self._begin()

    def _begin(self) -> None:
        self._learning = self._cache.lights.learning()
        self._spreading: Spreading | None = None
        self._done = 0

    @property
    def renewed(self) -> float:
        """Share of the updates after the lights changed that were made."""
        return self._done / (PARTS + self._spreading.steps) if self._spreading is not None else 0.0

    def update(self) -> IrradianceCache:
        """The cache, with a further part of its light renewed; as it was once all of it is."""
        if self.renewed == 1:
            return self._cache
        # The part is sampled while light is passed on.
        part = self._resampling.next_part() if self._done < PARTS else None
        if self._spreading is not None:
            self._spreading.step()
        if part is not None:
            self._add(part)
        self._done += 1
        irradiance = self._spread().irradiance(self._cells)
        lights = self._learning.choice()
        self._cache = replace(self._cache, irradiance=irradiance, lights=lights, renewed=self.renewed)
        return self._cache

    def _add(self, part: Part) -> None:
        """Learns from new samples."""
        self._direct.add(self._transfer.patch[part.points], part.direct())
        self._reflected.add(self._transfer.ray_regions[part.rays], part.reflected())
        self._learning.add(part.lights(), self._rows[part.points])

    def _spread(self) -> Spreading:
        """The light on its way, with what is known of direct light now; all the way at first."""
        if self._spreading is None:
            self._spreading = Spreading(self._transfer.transport, self._light(), self._most)
        elif self._done <= PARTS:
            self._spreading.light(self._light())
            if self._done == PARTS:
                self._spreading.restart()
        return self._spreading

    def _light(self) -> NDArray[np.float32]:
        return self._transfer.of_cells(self._direct.sums(), self._reflected.sums())
