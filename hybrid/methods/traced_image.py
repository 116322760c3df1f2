"""Path-traced images without splats."""

from __future__ import annotations

import math

from compose.camera.camera import Camera
from compose.image.colour import Image
from hybrid.runtime.clock import Clock
from pathtrace.trace.film import FilmPositions
from pathtrace.trace.fractional import fractional_counts
from pathtrace.trace.image import TracedImage, auxiliary_images, radiance_image, trace_image
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
    """(N / columns, columns, 3) radiance at N film positions.

    Args:
        tracer: of the scene.
        camera: the view, to whose film the positions refer.
        positions: of the image's pixels, row by row.
        columns: of the image.
        spp: samples per position, at least 1; of a fractional number the mean over all positions.
        seed: same seed, same image on the same machine.
        denoised: whether to denoise with OIDN, guided by albedo and normal.
        clock: records the passes trace and denoise.
    """
    clock = clock or Clock()
    counts = fractional_counts(spp, positions.count, seed)
    if not denoised:
        radiance = radiance_image(tracer, camera, positions, columns, counts, seed)
        clock.lap("trace")
        return radiance
    if isinstance(counts, int):
        traced = trace_image(tracer, camera, positions, columns, counts, seed)
    else:
        radiance = radiance_image(tracer, camera, positions, columns, counts, seed)
        spp_of_auxiliary = auxiliary_spp(math.ceil(spp))
        auxiliary = auxiliary_images(tracer, camera, positions, columns, spp_of_auxiliary, seed)
        traced = TracedImage(radiance, *auxiliary)
    clock.lap("trace")
    image = traced.denoised()
    clock.lap("denoise")
    return image
