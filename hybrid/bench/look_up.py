"""Time of a look-up in an irradiance cache, measured alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from compose.camera.camera import Camera
from pathtrace.base.frozen import Frozen
from pathtrace.cache.cache import IrradianceCache, look_up
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.first_hit import first_hits
from pathtrace.trace.rays import opaque_camera, ray_through

# Look-ups at each point, for one alone is hidden by the start of the kernel.
_LOOK_UPS = 32
_REPEATS = 7
# More than any cache tells apart.
_SEGMENTS = 99


def look_up_ns(scene: Scene, camera: Camera, cache: IrradianceCache) -> float:
    """Nanoseconds of a look-up at the surface points of a view, all threads of the machine at work.

    It is the time of a kernel that looks up, less that of the same kernel without; cells of all sizes may
    answer.
    """
    positions = frame_positions(camera)
    ray = ray_through(opaque_camera(camera), positions.x + 0.5, positions.y + 0.5)
    hit = first_hits(scene.mitsuba, ray, mi.Bool(True)).last
    valid = hit.is_valid()
    points = hit.p, mi.Normal3f(dr.select(hit.wi.z > 0, hit.n, -hit.n)), valid
    dr.eval(points)
    known = cache.arrays(scene.mitsuba).irradiance
    kernels = {asks: Frozen(_kernel(asks)) for asks in (False, True)}
    times: dict[bool, list[float]] = {asks: [] for asks in kernels}
    for number in range(1 + _REPEATS):
        for asks, kernel in kernels.items():
            state = dr.opaque(mi.UInt32, number)
            dr.sync_thread()
            start = time.perf_counter()
            kernel(state, known, *points)
            dr.sync_thread()
            times[asks].append(time.perf_counter() - start)
    # The first of each kind compiles.
    seconds = {asks: float(np.median(measured[1:])) for asks, measured in times.items()}
    count = max(int(dr.count(valid)[0]), 1) * _LOOK_UPS
    return 1e9 * max(seconds[True] - seconds[False], 0.0) / count


def _kernel(asks: bool) -> Callable[..., Any]:
    """A function that looks up at points many times, or does all the same but for that."""
    return lambda *arrays: _repeated(asks, *arrays)


@dr.syntax
def _repeated(asks: bool, state: Any, known: Any, position: Any, normal: Any, valid: Any) -> Any:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(state, dr.width(position))
    total, number = dr.zeros(mi.Color3f, dr.width(position)), mi.UInt32(0)
    while dr.hint(number < _LOOK_UPS, exclude=[asks, known, position, normal, valid]):
        jitter = sampler.next_2d(valid)
        total += jitter.x + jitter.y + _answer(asks, known, position, normal, jitter, valid)
        number += 1
    dr.eval(total)
    return total


def _answer(asks: bool, known: Any, position: Any, normal: Any, jitter: Any, valid: Any) -> Any:
    if not asks:
        return mi.Color3f(0)
    return look_up(known, position, normal, mi.Float(dr.inf), mi.UInt32(_SEGMENTS), jitter, valid)[1]
