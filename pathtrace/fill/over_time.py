"""Irradiance of surfaces over time: what shadows and lights that move do to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import interp1d

from pathtrace.cache.cache import IrradianceCache, look_up
from pathtrace.cache.cells import Points
from pathtrace.fill.gather import gather_direct, gather_seen
from pathtrace.scene.scene import Scene

# Times that the lights are sampled at each point and time, a few samples each.
_ROUNDS = 4
# Rays from each point for the light that comes over other surfaces.
_RAYS = 16
# Times at which these are followed from what moves; light from all sides changes slowly.
_INDIRECT = 17
# Any cell will do for these.
_ANY_AREA = 1e9


def irradiance_over_time(
    scene: Scene,
    cache: IrradianceCache,
    points: Callable[[float], Points],
    moving: NDArray[np.int64],
    times: Sequence[float],
    seed: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> NDArray[np.float32]:
    """(T, 3, N) irradiance of N points at T times.

    Light that comes over other surfaces has the irradiance of time 0 there; on what stands still, it is as
    at time 0. All times have the same random numbers, so that their ratios have less noise than they.

    Args:
        scene: a scene that moves; afterwards it shows the last time.
        cache: of its irradiance at time 0.
        points: where the N points are at a time.
        moving: (M,) which of them move.
        times: from 0 to 1, ascending.
        seed: same seed, same irradiance on the same machine.
        progress: called with times done and their number.
    """
    scene.set_time(0.0)
    indirect = _indirect(scene, cache, points(0.0), seed)
    found = np.empty((len(times), *indirect.shape), dtype=np.float32)
    some = np.unique(np.linspace(0, len(times) - 1, _INDIRECT).round().astype(int))
    arriving = []
    for number, time in enumerate(times):
        scene.set_time(time)
        now = points(time)
        rounds = [gather_direct(scene.mitsuba, now, seed + n).irradiance for n in range(_ROUNDS)]
        found[number] = indirect + np.mean(rounds, axis=0).T
        if len(moving) and number in some:
            arriving.append(_indirect(scene, cache, now.take(moving), seed))
        progress(number + 1, len(times))
    if len(moving):
        found[..., moving] += interp1d(some, arriving, axis=0)(np.arange(len(times))) - indirect[:, moving]
    # Rounding may leave a little less than nothing.
    return np.maximum(found, 0, out=found)


def _indirect(scene: Scene, cache: IrradianceCache, points: Points, seed: int) -> NDArray[np.float32]:
    """(3, N) irradiance that arrives over other surfaces, whose own irradiance is that of the cache."""
    rng = np.random.default_rng(seed)
    start = np.repeat(np.arange(len(points)), _RAYS)
    seen = gather_seen(scene.mitsuba, points, start, rng.random((len(start), 2), dtype=np.float32), seed)
    position, normal = mi.Point3f(seen.hits.position.T), mi.Vector3f(seen.hits.normal.T)
    middle = mi.Point2f(0.5)
    most = mi.UInt32(len(cache.irradiance))
    arrays = cache.arrays(scene.mitsuba).irradiance
    _, irradiance = look_up(arrays, position, normal, mi.Float(_ANY_AREA), most, middle, mi.Bool(seen.valid))
    dr.eval(irradiance)
    # Of the radiance that arrives, irradiance is pi times the mean over cosine-weighted directions.
    arriving = seen.reflectance * irradiance.numpy().T * seen.valid[:, None] + np.pi * seen.radiance
    return arriving.reshape(-1, _RAYS, 3).mean(axis=1).T.astype(np.float32)
