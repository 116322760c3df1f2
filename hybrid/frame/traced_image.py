"""Path-traced pictures without any splats."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image
from hybrid.frame.disc import is_quick
from hybrid.runtime.clock import Clock
from pathtrace.base.denoise import denoise
from pathtrace.trace.film import FilmPositions, interleaved
from pathtrace.trace.tracer import Tracer, auxiliary_spp


def traced_image(
    tracer: Tracer,
    camera: Camera,
    positions: FilmPositions,
    columns: int,
    spp: float,
    seed: int,
    denoised: bool,
    clock: Clock | None = None,
) -> Image:
    """(N / columns, columns, 3) radiance of N film positions that lie in rows.

    Args:
        tracer: of the scene.
        camera: the view; its film coordinates are those of the positions.
        positions: of the picture's pixels.
        columns: of the picture.
        spp: samples per position, at least 1 each; where that is no whole number, the mean over all of them.
        seed: same seed, same picture.
        denoised: by OIDN, with albedo and normal.
        clock: gets the laps trace and denoise.
    """
    image = lambda channels: interleaved(channels).reshape(-1, columns, 3)  # noqa: E731
    clock = clock or Clock()
    radiance = image(tracer.trace(camera, positions, _counts(spp, positions.count, seed), seed).radiance)
    clock.lap("trace")
    if not denoised:
        return radiance
    auxiliary = tracer.auxiliary(camera, positions, auxiliary_spp(math.ceil(spp)), seed)
    cleaned = denoise(radiance, image(auxiliary.albedo), image(auxiliary.normal), is_quick(spp))
    clock.lap("denoise")
    return cleaned


def _counts(spp: float, positions: int, seed: int) -> int | NDArray[np.int64]:
    """Samples of each position: the whole numbers below and above, in such shares that the mean is met."""
    whole = math.floor(spp)
    if spp == whole:
        return whole
    more = round((spp - whole) * positions)
    counts = np.full(positions, whole, dtype=np.int64)
    counts[np.random.default_rng(seed).permutation(positions)[:more]] += 1
    return counts
