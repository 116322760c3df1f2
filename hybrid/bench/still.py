"""How a picture gets better while nothing moves, frame by frame, as the window makes them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.image.colour import Image, srgb_from_radiance
from hybrid.frame.live import LiveRenderer
from hybrid.frame.settings import FrameSettings
from hybrid.interactive.loop import FrameLoop
from hybrid.interactive.request import Request
from hybrid.interactive.source import FrameSource
from hybrid.measure.reference import REFERENCE_SEED, reference
from pathtrace.trace.tracer import Tracer

# Frames elsewhere that compile the kernels.
_WARM_UP = 6
# The reference is denoised: with few samples right beside the disc, their noise would leak into it. Pixels.
_MARGIN = 32
# Samples per pixel of what lies farther off.
_ELSEWHERE = 4
# Seconds in which frames still hurry.
_HURRIED = 1.0


def bench_still(
    renderer: LiveRenderer,
    settings: FrameSettings,
    seconds: float,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    """PSNR of the disc, before it is blended, in sRGB against a reference, for each frame.

    Args:
        renderer: of the scene.
        settings: of the frames, with camera and gaze.
        seconds: for which nothing moves.
        reference_spp: samples per pixel of the reference, where the disc is.
        progress: called with seconds done and seconds in all.

    Returns:
        `frames`, each with its `seconds`, `spp` and `psnr`; `reference_psnr`, of the reference itself against
        the truth; `most_fall`, by how many dB a frame was worse than the best one before it, at most, once
        frames hurry no more.
    """
    loop = FrameLoop(FrameSource(renderer), lambda request: [])
    gaze = settings.gaze
    camera, _ = settings.resolved(renderer.scene.camera)
    request = lambda at: Request(replace(settings, gaze=at))  # noqa: E731
    for number in range(_WARM_UP):
        loop.make(request(Gaze(1 - gaze.x, 0.01 * number)))
    renderer.forget()
    seen: list[tuple[float, float, Image]] = []
    start = time.perf_counter()
    while not seen or seen[-1][0] < seconds:
        shown = loop.make(request(gaze))
        seen.append((time.perf_counter() - start, shown.spp, shown.frame.fovea.radiance.copy()))
        progress(int(seen[-1][0]), int(seconds) + 1)
    disc = np.zeros((camera.height, camera.width), dtype=bool)
    disc.ravel()[shown.frame.region.pixels] = True
    truth, certainty = _reference(renderer.tracer, camera, disc, reference_spp)
    psnr = [_psnr(radiance, truth) for _, _, radiance in seen]
    best = np.maximum.accumulate(psnr)
    falls = [b - p for (at, _, _), b, p in zip(seen, best, psnr, strict=True) if at > _HURRIED]
    frames = [{"seconds": at, "spp": spp, "psnr": p} for (at, spp, _), p in zip(seen, psnr, strict=True)]
    progress(int(seconds) + 1, int(seconds) + 1)
    return {
        "scene": renderer.scene.name,
        "gaze": [gaze.x, gaze.y],
        "reference_spp": reference_spp,
        "reference_psnr": certainty,
        "most_fall": float(max(falls, default=0.0)),
        "frames": frames,
    }


def _reference(tracer: Tracer, camera: Camera, disc: NDArray[np.bool_], spp: int) -> tuple[Image, float]:
    """(D, 3) radiance of a disc, and the PSNR of that itself."""
    counts = np.where(binary_dilation(disc, iterations=_MARGIN), spp, min(spp, _ELSEWHERE))
    found = reference(tracer, camera, counts.ravel(), REFERENCE_SEED)
    return found.radiance[disc], found.psnr(disc)


def _psnr(radiance: Image, truth: Image) -> float:
    """In dB, of (D, 3) radiance in sRGB."""
    error = np.mean((srgb_from_radiance(radiance) - srgb_from_radiance(truth)) ** 2, dtype=np.float64)
    return float(-10 * np.log10(max(error, 1e-12)))
