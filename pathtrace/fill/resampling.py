"""Samples of the light that lights send as they are now, at the points and rays of a cache, part by part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from pathtrace.base.frozen import Frozen
from pathtrace.cache.lights import LightSamples, light_numbers
from pathtrace.cache.transfer import Transfer
from pathtrace.fill.direct import SAMPLES, followed, lit, stratified, surface_at


@dataclass(frozen=True)
class Part:
    """New samples at n of the points of a `Transfer`, and of m of its rays; computed when they are read.

    Attributes:
        points: which points, in their order.
        rays: which rays.
        sampled: Dr.Jit arrays: of the points' irradiance, of that of each sample, and of its light.
        shown: Dr.Jit arrays of the irradiance by rays.
        numbers: index of each light by the number by which kernels know it.
    """

    points: slice
    rays: slice
    sampled: tuple[Any, ...]
    shown: tuple[Any, ...]
    numbers: NDArray[np.uint32]

    def direct(self) -> NDArray[np.float32]:
        """(n, 3) irradiance of the points from lights."""
        return _rows(self.sampled[:3], self.points)

    def reflected(self) -> NDArray[np.float32]:
        """(m, 3) irradiance from lights that rays found in mirrors, glossy surfaces and glass."""
        return _rows(self.shown, self.rays)

    def lights(self) -> LightSamples:
        """The samples of lights; their points are numbered from the first of the part on."""
        count = SAMPLES * (self.points.stop - self.points.start)
        irradiance, registered = (values.numpy()[:count] for values in self.sampled[3:])
        return LightSamples(np.arange(count) // SAMPLES, self.numbers[registered], irradiance)


class Resampling:
    """Samples the lights of a scene in a number of parts, round after round.

    Args:
        scene: a Mitsuba scene.
        transfer: its points and rays.
        parts: number of parts.
        seed: same seed, same samples.
    """

    def __init__(self, scene: Any, transfer: Transfer, parts: int, seed: int):
        self._scene, self._numbers = scene, light_numbers(scene)
        self._parts, self._next, self._random = parts, 0, np.random.default_rng(seed)
        self._counts = len(transfer.points), len(transfer.rays)
        self._sizes = tuple(-(-count // parts) for count in self._counts)
        position, normal = transfer.points.position, transfer.points.normal
        self._points = mi.Point3f(position.T), mi.Normal3f(normal.T)
        # One more ray, since kernels cannot read from an empty array.
        self._rays = (
            mi.UInt32(np.append(transfer.rays.point, np.int32(0)).astype(np.uint32)),
            mi.Point2f(np.append(transfer.rays.square, np.zeros((1, 2), np.float32), axis=0).T),
            mi.Float(np.append(transfer.rays.weight, np.float32(0))),
        )
        dr.eval(self._points, self._rays)
        self._light, self._show = Frozen(self._of_points), Frozen(self._of_rays)

    def next_part(self) -> Part:
        """Samples of the part after the last one, under the lights as they are now."""
        points, rays = (
            slice(min(self._next * size, count), min((self._next + 1) * size, count))
            for size, count in zip(self._sizes, self._counts, strict=True)
        )
        self._next = (self._next + 1) % self._parts
        sampled = self._light(self._scene, self._state(), dr.opaque(mi.UInt32, points.start), *self._points)
        shown: tuple[Any, ...] = ()
        if self._sizes[1]:
            first = dr.opaque(mi.UInt32, rays.start)
            shown = self._show(self._scene, self._state(), first, *self._points, *self._rays)
        return Part(points, rays, sampled, shown, self._numbers)

    def _state(self) -> Any:
        return dr.opaque(mi.UInt32, int(self._random.integers(1 << 32)))

    def _of_points(self, scene: Any, state: Any, first: Any, position: Any, normal: Any) -> tuple[Any, ...]:
        """Direct light at points, its samples and their lights; frozen."""
        lane = dr.arange(mi.UInt32, self._sizes[0] * SAMPLES)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(state, self._sizes[0] * SAMPLES)
        point = first + lane // SAMPLES
        active = point < self._counts[0]
        at = surface_at(
            dr.gather(mi.Point3f, position, point, active), dr.gather(mi.Normal3f, normal, point, active)
        )
        squares = stratified(sampler, lane), stratified(sampler, lane)
        irradiance, by_shadow_rays, registered = lit(scene, at, *squares, active)
        samples = [*irradiance, dr.mean(by_shadow_rays), registered]
        dr.eval(samples)
        means = [dr.block_sum(channel, SAMPLES) / SAMPLES for channel in samples[:3]]
        dr.eval(means)
        return *means, *samples[3:]

    def _of_rays(
        self, scene: Any, state: Any, first: Any, position: Any, normal: Any, *rays: Any
    ) -> tuple[Any, ...]:
        """Light of lights that rays find; frozen."""
        point, square, weight = rays
        ray = first + dr.arange(mi.UInt32, self._sizes[1])
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(state, self._sizes[1])
        active = ray < self._counts[1]
        start = dr.gather(mi.UInt32, point, ray, active)
        at = surface_at(
            dr.gather(mi.Point3f, position, start, active), dr.gather(mi.Normal3f, normal, start, active)
        )
        found = followed(scene, sampler, at, dr.gather(mi.Point2f, square, ray, active), active)
        counts = dr.gather(mi.Float, weight, ray, active)
        shown = tuple(dr.select(active, counts * channel, 0) for channel in found.radiance)
        dr.eval(shown)
        return shown


def _rows(channels: tuple[Any, ...], part: slice) -> NDArray[np.float32]:
    """(n, 3) the values of a part; lanes beyond its end are left out."""
    if not channels:
        return np.zeros((0, 3), dtype=np.float32)
    return np.stack([channel.numpy()[: part.stop - part.start] for channel in channels], axis=1)
