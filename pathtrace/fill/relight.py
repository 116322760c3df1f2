"""Follows lights that change: their light is sampled anew, part by part, and passed on along known links.

Only what lights send changes with them. What surfaces do with light stays as the cache was filled with it.
Until a place has new samples, its old light stands for them, scaled by how the light of its region changed: a
lamp that is dimmed dims at once wherever it shines. When all samples were taken anew, nothing old is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pathtrace.cache.cells import Floats, Indices
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.cache.light_selection import LightLearning, LightSamples, light_numbers
from pathtrace.cache.transport import Transfer, Transport, sums_by, told_apart
from pathtrace.fill.filling import segments_beyond_cache
from pathtrace.fill.gather import SAMPLES, followed, sampled_lights, surfaces_at
from pathtrace.scene.instances import AnyScene, FrozenWithScenes
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import random_numbers

# Share of the mean light that a dark place is taken to have had: where it was dark, a lamp may now shine.
_LEAST = 1e-3
# New samples of a region that count as much as those of all regions.
_TRUST = 8
# Keeps the light of places that never had any above 0.
_DARK = 1e-12
# Steps at most in which new light has passed all segments.
_STEPS = 8
# Updates in which all points and rays are sampled anew.
PARTS = 12


class Renewal:
    """Sums over A places in regions (A,), numbered from 0 on, before and after a change of the light.

    Before, there are sums (A, 3) of the light of all samples of each place, and their numbers (A,).
    """

    def __init__(self, sums: NDArray[Any], numbers: Indices, regions: Indices):
        self._numbers, self._regions = numbers, regions
        places = np.arange(len(numbers))
        shape = int(regions.max(initial=-1)) + 1, len(numbers)
        self._summing = sparse.csr_array((np.ones(len(numbers)), (regions, places)), shape)
        mean = sums.sum(axis=0) / max(numbers.sum(), 1)
        # Where nothing was lit, any new light is taken to be even.
        self._old = sums / np.maximum(numbers, 1)[:, None] + np.maximum(_LEAST * mean, _DARK)
        count = np.maximum(self._summing @ numbers, 1)
        self._trust = _TRUST * (self._summing @ (numbers[:, None] * self._old)) / count[:, None] + _DARK
        self._new = np.zeros_like(self._old)
        self._renewed = np.zeros(len(numbers))

    def add(self, places: NDArray[Any], light: Floats) -> None:
        """Adds new samples: their places (M,), and their light (M, 3)."""
        self._new += sums_by(places, light, len(self._numbers))
        self._renewed += np.bincount(places, minlength=len(self._numbers))

    def sums(self) -> NDArray[np.float64]:
        """(A, 3) sums of the light of all samples of each place after the change."""
        found, expected = self._summing @ self._new, self._summing @ (self._renewed[:, None] * self._old)
        total = expected.sum(axis=0)
        overall = np.divide(found.sum(axis=0), total, out=np.ones(3), where=total > 0)
        change = (found + self._trust * overall) / (expected + self._trust)
        waiting = (self._numbers - self._renewed)[:, None]
        return self._new + waiting * self._old * change[self._regions]

    def again(self) -> Renewal:
        """The renewal after a further change."""
        return Renewal(self.sums(), self._numbers, self._regions)


class Spreading:
    """Irradiance of cells that follows direct light, which is sent as in `Transport.irradiance`."""

    def __init__(self, transport: Transport, sent: Floats, most: int):
        self._transport, self._next, self._sent = transport, 1, sent
        self._known = transport.every(sent, most)
        self._share = -(-(len(self._known) - 1) // _STEPS)

    @property
    def steps(self) -> int:
        """Steps after which nothing is left of the light before a restart."""
        return -(-(len(self._known) - 1) // max(self._share, 1))

    def step(self) -> None:
        """Passes light on by the next few segments; after the last one, by the first ones again."""
        for _ in range(self._share):
            self._next = self._next if self._next < len(self._known) else 1
            received = self._transport.received(self._known[: self._next])
            self._known[self._next] = self._sent[min(self._next, len(self._sent) - 1)] + received
            self._next += 1

    def light(self, sent: Floats, restart: bool = False) -> None:
        """Sets the light (S, C, 3) that the next steps pass on, from the first segment if restarted."""
        self._sent, self._known[0] = sent, sent[0]
        self._next = 1 if restart else self._next

    def irradiance(self, cells: Indices) -> Floats:
        """(K, c, 3) of cells given by their indices, as in `IrradianceCache`."""
        return told_apart([np.take(light, cells, axis=0) for light in self._known])


@dataclass(frozen=True)
class Part:
    """New samples at n points of a `Transfer` and m of its rays; computed when they are read."""

    points: slice
    rays: slice
    sampled: tuple[mi.Float, ...]  # of the points: irradiance, that of each sample, and its light
    shown: tuple[mi.Float, ...]  # irradiance by the rays
    numbers: NDArray[np.uint32]  # indices of lights, by the numbers by which kernels know them

    def direct(self) -> Floats:
        """(n, 3) irradiance of the points from lights."""
        return _rows(self.sampled[:3], self.points)

    def reflected(self) -> Floats:
        """(m, 3) irradiance from lights that rays found in mirrors, glossy surfaces and glass."""
        return _rows(self.shown, self.rays)

    def lights(self) -> LightSamples:
        """The samples of lights; their points are numbered from the first of the part on."""
        count = SAMPLES * (self.points.stop - self.points.start)
        irradiance, registered = (values.numpy()[:count] for values in self.sampled[3:])
        return LightSamples(np.arange(count) // SAMPLES, self.numbers[registered], irradiance)


class Resampling:
    """Samples the lights of a Mitsuba scene from the points and rays of a transfer, part by part."""

    def __init__(self, scene: AnyScene, transfer: Transfer, parts: int, seed: int):
        self._scene, self._numbers = scene, light_numbers(scene)
        self._parts, self._next, self._random = parts, 0, np.random.default_rng(seed)
        self._counts = len(transfer.points), len(transfer.rays)
        self._sizes = tuple(-(-count // parts) for count in self._counts)
        self._points = transfer.points.arrays
        # One more ray, since kernels cannot read from an empty array.
        self._rays = (
            mi.UInt32(np.append(transfer.rays.point, np.int32(0)).astype(np.uint32)),
            mi.Point2f(np.append(transfer.rays.square, np.zeros((1, 2), np.float32), axis=0).T),
            mi.Float(np.append(transfer.rays.weight, np.float32(0))),
        )
        dr.eval(self._points, self._rays)
        self._light, self._show = FrozenWithScenes(self._of_points), FrozenWithScenes(self._of_rays)

    def next_part(self) -> Part:
        """Samples of the part after the last one, under the lights as they are now."""
        points, rays = (
            slice(min(self._next * size, count), min((self._next + 1) * size, count))
            for size, count in zip(self._sizes, self._counts, strict=True)
        )
        self._next = (self._next + 1) % self._parts
        sampled = self._light(self._scene, *self._from(points), self._points)
        shown: tuple[mi.Float, ...] = ()
        if self._sizes[1]:
            shown = self._show(self._scene, *self._from(rays), self._points, self._rays)
        return Part(points, rays, sampled, shown, self._numbers)

    def _from(self, part: slice) -> tuple[mi.UInt32, ...]:
        return tuple(dr.opaque(mi.UInt32, n) for n in (int(self._random.integers(1 << 32)), part.start))

    def _of_points(
        self, scene: AnyScene, state: mi.UInt32, first: mi.UInt32, places: tuple[mi.Point3f, mi.Normal3f]
    ) -> tuple[mi.Float, ...]:
        """Direct light at points, its samples and their lights; frozen."""
        return sampled_lights(scene, state, places, self._sizes[0], first, self._counts[0])

    def _of_rays(
        self, scene: AnyScene, state: mi.UInt32, first: mi.UInt32, *given: tuple[Any, ...]
    ) -> tuple[mi.Float, ...]:
        """Light of lights that rays find; frozen."""
        (position, normal), (point, square, weight) = given
        ray = first + dr.arange(mi.UInt32, self._sizes[1])
        sampler = random_numbers(state, self._sizes[1])
        active = ray < self._counts[1]
        start = dr.gather(mi.UInt32, point, ray, active)
        at = surfaces_at((position, normal), start, active)
        found = followed(scene, sampler, at, dr.gather(mi.Point2f, square, ray, active), active)
        counts = dr.gather(mi.Float, weight, ray, active)
        shown = tuple(dr.select(active, counts * channel, 0) for channel in found.radiance)
        dr.eval(shown)
        return shown


def _rows(channels: tuple[Any, ...], part: slice) -> Floats:
    """(n, 3) the values of a part; lanes beyond its end are left out."""
    if not channels:
        return np.zeros((0, 3), dtype=np.float32)
    return np.stack([channel.numpy()[: part.stop - part.start] for channel in channels], axis=1)


class Relighting:
    """The light of a cache, kept up to date with the lights of its scene, which have just changed.

    The cache has at least one cell, and all of its light is known. Same seed, same light on the same machine.
    """

    def __init__(self, scene: Scene, cache: IrradianceCache, seed: int = 0):
        self._transfer, self._cache = cache.transfer, cache
        self._resampling = Resampling(scene.traced, cache.transfer, PARTS, seed)
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
        self._learning, self._done = LightLearning(self._cache.lights), 0
        self._spreading: Spreading | None = None

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
            self._direct.add(self._transfer.patch[part.points], part.direct())
            self._reflected.add(self._transfer.ray_regions[part.rays], part.reflected())
            self._learning.add(part.lights(), self._rows[part.points])
        self._done += 1
        irradiance = self._spread().irradiance(self._cells)
        lights = self._learning.choice()
        self._cache = replace(self._cache, irradiance=irradiance, lights=lights, renewed=self.renewed)
        return self._cache

    def _spread(self) -> Spreading:
        """The light on its way, with what is known of direct light now; all the way at first."""
        if self._spreading is not None and self._done > PARTS:
            return self._spreading
        light = self._transfer.of_cells(self._direct.sums(), self._reflected.sums())
        if self._spreading is None:
            self._spreading = Spreading(self._transfer.transport, light, self._most)
        else:
            self._spreading.light(light, restart=self._done == PARTS)
        return self._spreading
