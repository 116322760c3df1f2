"""Efficiency and bias of the cached integrator against the unbiased one."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image
from hybrid.frame.irradiance import filled_cache
from hybrid.measure.reference import REFERENCE_SEED
from hybrid.measure.timing import percentiles
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.image import radiance_image
from pathtrace.trace.integrator import Integrator
from pathtrace.trace.tracer import Tracer

# Side in pixels of the blocks in which bias is looked for.
BLOCK = 32
# Samples per pixel at which frames are timed.
_SPP = (1, 4)
# Frames of which the first of each kind is not measured, for it compiles kernels.
_WARM_UP = 1
# Samples per pixel in one pass of an image of many.
_PASS = 64


def bench_integrator(
    scene: Scene,
    camera: Camera,
    reference_spp: int,
    repeats: int,
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    """Raw frames of both integrators, interleaved, against an unbiased reference.

    Args:
        scene, camera: what is rendered.
        reference_spp: samples per pixel of the reference, and of the image that bias is measured in.
        repeats: measured frames per integrator and sample count.
        progress: called with samples per pixel done and in total.

    Returns:
        `cache` (seconds, cells, bytes); `rows`, one per integrator and sample count: squared_error per pixel
        and channel, ms, efficiency (1 / (squared error x time)) over that of `path`; `bias`, one row per
        integrator: of the mean, and of the worst and the 95th percentile of blocks of 32 x 32 pixels, as
        fractions. That of `path` is due to noise alone, and so are the others' where they are no larger.
    """
    passes = -(-reference_spp // _PASS)
    total = 3 * passes * _PASS + 2 * sum(_SPP) * (repeats + _WARM_UP)
    done = 0

    def advance(samples: int) -> None:
        nonlocal done
        done += samples
        progress(done, total)

    start = time.perf_counter()
    cache = filled_cache(scene)
    facts = {"seconds": time.perf_counter() - start, "cells": len(cache.cells), "bytes": cache.bytes}
    tracers = {Integrator.PATH: Tracer(scene), Integrator.CACHED: Tracer(scene, cache=cache)}
    truth = _converged(tracers[Integrator.PATH], camera, passes, REFERENCE_SEED, advance)
    rows = [row for spp in _SPP for row in _rows(tracers, camera, truth, spp, repeats, advance)]
    bias = []
    for integrator, tracer in tracers.items():
        found = _converged(tracer, camera, passes, REFERENCE_SEED + passes, advance)
        bias.append({"integrator": integrator.value, **relative_errors(found, truth)})
    return {"cache": facts, "rows": rows, "bias": bias}


def relative_errors(image: NDArray[np.float64], truth: NDArray[np.float64]) -> dict[str, float]:
    """Relative errors of the mean of an (H, W, 3) image, and of its blocks: the worst and a high one.

    Blocks that are cut by the frame's border count as well; black ones do not.
    """
    found, expected = _block_sums(image), _block_sums(truth)
    lit = expected > 0
    blocks = np.abs(found[lit] / expected[lit] - 1) if lit.any() else np.zeros(1)
    mean = float(image.mean() / truth.mean() - 1) if truth.mean() > 0 else 0.0
    return {"mean": mean, "worst_block": float(blocks.max()), "p95_block": float(np.percentile(blocks, 95))}


def _block_sums(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over blocks of BLOCK x BLOCK pixels."""
    sums = image.sum(axis=2)
    for axis in (0, 1):
        sums = np.add.reduceat(sums, np.arange(0, image.shape[axis], BLOCK), axis=axis)
    return sums


def _rows(
    tracers: dict[Integrator, Tracer],
    camera: Camera,
    truth: NDArray[np.float64],
    spp: int,
    repeats: int,
    advance: Callable[[int], None],
) -> list[dict[str, Any]]:
    """Error and time of each integrator at one sample count, in turns."""
    errors: dict[Integrator, list[float]] = {integrator: [] for integrator in tracers}
    times: dict[Integrator, list[float]] = {integrator: [] for integrator in tracers}
    for number in range(_WARM_UP + repeats):
        for integrator, tracer in tracers.items():
            start = time.perf_counter()
            image = _image(tracer, camera, spp, number)
            milliseconds = 1000 * (time.perf_counter() - start)
            if number >= _WARM_UP:
                times[integrator].append(milliseconds)
                errors[integrator].append(float(((image - truth) ** 2).mean()))
            advance(spp)
    work = {one: float(np.mean(errors[one]) * np.median(times[one])) for one in tracers}
    return [
        {
            "integrator": integrator.value,
            "spp": spp,
            "squared_error": float(np.mean(errors[integrator])),
            "ms": percentiles(times[integrator]),
            "efficiency": work[Integrator.PATH] / work[integrator] if work[integrator] > 0 else 1.0,
        }
        for integrator in tracers
    ]


def _converged(
    tracer: Tracer, camera: Camera, passes: int, seed: int, advance: Callable[[int], None]
) -> NDArray[np.float64]:
    """(H, W, 3) mean of many samples per pixel, in float64."""
    total = np.zeros((camera.height, camera.width, 3))
    for number in range(passes):
        total += _image(tracer, camera, _PASS, seed + number)
        advance(_PASS)
    return total / passes


def _image(tracer: Tracer, camera: Camera, spp: int, seed: int) -> Image:
    return radiance_image(tracer, camera, frame_positions(camera), camera.width, spp, seed)
