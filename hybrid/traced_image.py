"""Path-traced pictures without any splats."""

from __future__ import annotations

from compose.blend import Image
from compose.view import Camera
from hybrid.disc import is_quick
from hybrid.timing import Clock
from pathtrace.denoise import denoise
from pathtrace.film import FilmPositions, interleaved
from pathtrace.tracer import Tracer, guide_places


def traced_image(
    tracer: Tracer,
    camera: Camera,
    positions: FilmPositions,
    columns: int,
    spp: int,
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
        spp: samples per position.
        seed: same seed, same picture.
        denoised: by OIDN, with albedo and normal.
        clock: gets the laps trace and denoise.
    """
    image = lambda channels: interleaved(channels).reshape(-1, columns, 3)  # noqa: E731
    clock = clock or Clock()
    radiance = image(tracer.trace(camera, positions, spp, seed).radiance)
    clock.lap("trace")
    if not denoised:
        return radiance
    guides = tracer.guides(camera, positions, guide_places(spp), seed)
    cleaned = denoise(radiance, image(guides.albedo), image(guides.normal), is_quick(spp))
    clock.lap("denoise")
    return cleaned
