"""Efficiency and bias of the cached integrator against the unbiased one, and the time of a look-up."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image
from hybrid.base.progress import Steps
from hybrid.measure.frame_times import percentiles
from hybrid.measure.reference import REFERENCE_SEED
from hybrid.render.irradiance import filled_cache
from pathtrace.cache.irradiance_cache import IrradianceCache, look_up
from pathtrace.scene.instances import FrozenWithScenes
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator
from pathtrace.trace.film import frame_positions, opaque_camera, ray_through
from pathtrace.trace.first_hit import first_hits
from pathtrace.trace.traced_images import radiance_image
from pathtrace.trace.tracer import Tracer

# Samples per pixel at which frames are timed.
_SPP = (1, 4, 64, 256)
# Frames of which the first of each kind is not measured, for it compiles kernels.
_WARM_UP = 1
# Frames of as many samples as this and more are few: their errors differ little.
_MANY, _FEW = 16, 2
# Side in pixels of the blocks in which bias is looked for.
BLOCK = 32
# Samples per pixel in one pass of an image of many.
PASS = 64
# Look-ups at each point, for one alone is hidden by the start of the kernel.
_LOOK_UPS = 32
_REPEATS = 7
# More than any cache tells apart.
_SEGMENTS = 99


def bench_integrator(
    scene: Scene, camera: Camera, reference_spp: int, repeats: int, progress: Steps
) -> dict[str, Any]:
    """Raw frames of both integrators, interleaved, against an unbiased reference.

    The reference, and the image that bias is measured in, have `reference_spp` samples per pixel; `repeats`
    are measured frames per integrator and sample count below 16. Progress counts samples per pixel.

    Returns:
        `cache` (seconds, cells, bytes, transfer_bytes, look_up_ns); `rows`, one per integrator and sample
        count: squared_error per pixel and channel, without that of the reference, ms, efficiency
        (1 / (squared error x time)) over that of `path`; `bias`, one row per integrator: of the mean, and of
        the worst and the 95th percentile of blocks of 32 x 32 pixels, as fractions. That of `path` is due to
        noise alone, and so are the others' where they are no larger.
    """
    half, done = -(-reference_spp // (2 * PASS)), 0
    frames = {spp: repeats if spp < _MANY else min(repeats, _FEW) for spp in _SPP}
    total = 6 * half * PASS + 2 * sum(spp * (frames[spp] + _WARM_UP) for spp in _SPP)

    def advance(samples: int) -> None:
        nonlocal done
        done += samples
        progress(done, total)

    start = time.perf_counter()
    cache = filled_cache(scene)
    facts = {"seconds": time.perf_counter() - start, "cells": len(cache.cells), "bytes": cache.bytes}
    facts |= {"transfer_bytes": cache.transfer.bytes, "look_up_ns": look_up_ns(scene, camera, cache)}
    tracers = {Integrator.PATH: Tracer(scene), Integrator.CACHED: Tracer(scene, cache=cache)}
    one, other = (
        converged(tracers[Integrator.PATH], camera, half, seed, advance)
        for seed in (REFERENCE_SEED, REFERENCE_SEED + half)
    )
    truth, own_error = (one + other) / 2, float(((one - other) ** 2).mean() / 4)
    errors = partial(_rows, tracers, camera, truth, own_error)
    rows = [row for spp in _SPP for row in errors(spp, frames[spp], advance)]
    bias = []
    for integrator, tracer in tracers.items():
        found = converged(tracer, camera, 2 * half, REFERENCE_SEED + 2 * half, advance)
        bias.append({"integrator": integrator.value, **relative_errors(found, truth)})
    return {"cache": facts, "rows": rows, "bias": bias}


def _rows(
    tracers: dict[Integrator, Tracer],
    camera: Camera,
    truth: NDArray[np.float64],
    own_error: float,
    spp: int,
    repeats: int,
    advance: Callable[[int], None],
) -> list[dict[str, Any]]:
    """Error and time of each integrator at one sample count, in turns."""
    errors, times = ({one: list[float]() for one in tracers} for _ in range(2))
    for number in range(_WARM_UP + repeats):
        for integrator, tracer in tracers.items():
            start = time.perf_counter()
            image = frame_of(tracer, camera, spp, number)
            milliseconds = 1000 * (time.perf_counter() - start)
            if number >= _WARM_UP:
                times[integrator].append(milliseconds)
                errors[integrator].append(float(((image - truth) ** 2).mean()) - own_error)
            advance(spp)
    error = {one: max(float(np.mean(errors[one])), 0.0) for one in tracers}
    work = {one: error[one] * float(np.median(times[one])) for one in tracers}
    return [
        {
            "integrator": integrator.value,
            "spp": spp,
            "squared_error": error[integrator],
            "ms": percentiles(times[integrator]),
            "efficiency": work[Integrator.PATH] / work[integrator] if work[integrator] > 0 else 1.0,
        }
        for integrator in tracers
    ]


def block_errors(image: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Relative errors of the blocks of an (H, W, 3) image that are not black; a single 0 if all are."""
    found, expected = _block_sums(image), _block_sums(truth)
    lit = expected > 0
    return found[lit] / expected[lit] - 1 if lit.any() else np.zeros(1)


def relative_errors(image: NDArray[np.float64], truth: NDArray[np.float64]) -> dict[str, float]:
    """Relative errors of the mean of an (H, W, 3) image, and of its blocks: the worst and a high one."""
    blocks = np.abs(block_errors(image, truth))
    mean = float(image.mean() / truth.mean() - 1) if truth.mean() > 0 else 0.0
    return {"mean": mean, "worst_block": float(blocks.max()), "p95_block": float(np.percentile(blocks, 95))}


def _block_sums(image: NDArray[np.float64]) -> NDArray[np.float64]:
    sums = image.sum(axis=2)
    for axis in (0, 1):
        sums = np.add.reduceat(sums, np.arange(0, image.shape[axis], BLOCK), axis=axis)
    return sums


def converged(
    tracer: Tracer, camera: Camera, passes: int, seed: int, advance: Callable[[int], None]
) -> NDArray[np.float64]:
    """(H, W, 3) mean of many samples per pixel, in float64."""
    total = np.zeros((camera.height, camera.width, 3))
    for number in range(passes):
        total += frame_of(tracer, camera, PASS, seed + number)
        advance(PASS)
    return total / passes


def frame_of(tracer: Tracer, camera: Camera, spp: int, seed: int) -> Image:
    """(H, W, 3) a raw frame."""
    return radiance_image(tracer, camera, frame_positions(camera), camera.width, spp, seed)


def look_up_ns(scene: Scene, camera: Camera, cache: IrradianceCache) -> float:
    """Nanoseconds of a look-up at the surface points of a view, all threads of the machine at work.

    It is the time of a kernel that looks up, less that of the same kernel without; cells of all sizes may
    answer.
    """
    positions = frame_positions(camera)
    ray = ray_through(opaque_camera(camera), positions.x + 0.5, positions.y + 0.5)
    hit = first_hits(scene.traced, ray, mi.Bool(True)).last
    valid = hit.is_valid()
    points = hit.p, mi.Normal3f(dr.select(hit.wi.z > 0, hit.n, -hit.n)), valid
    dr.eval(points)
    known = cache.arrays(scene.mitsuba).irradiance
    kernels = {asks: FrozenWithScenes(partial(_repeated, asks)) for asks in (False, True)}
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
    count = max(int(np.count_nonzero(valid.numpy())), 1) * _LOOK_UPS
    return 1e9 * max(seconds[True] - seconds[False], 0.0) / count


@dr.syntax
def _repeated(
    asks: bool,
    state: mi.UInt32,
    known: tuple[Any, ...],
    position: mi.Point3f,
    normal: mi.Normal3f,
    valid: mi.Bool,
) -> mi.Color3f:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(state, dr.width(position))
    total, number = dr.zeros(mi.Color3f, dr.width(position)), mi.UInt32(0)
    while dr.hint(number < _LOOK_UPS, exclude=[asks, known, position, normal, valid]):
        jitter = sampler.next_2d(valid)
        asked = position, normal, mi.Float(dr.inf), mi.UInt32(_SEGMENTS), jitter, valid
        total += jitter.x + jitter.y + (look_up(known, *asked)[1] if asks else 0)
        number += 1
    dr.eval(total)
    return total
