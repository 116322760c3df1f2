"""How the disc improves from frame to frame while nothing moves, as in the window."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.frame.live import LiveRenderer
from hybrid.frame.settings import FrameSettings
from hybrid.interactive.loop import FrameLoop
from hybrid.interactive.request import Request
from hybrid.interactive.source import FrameSource
from hybrid.measure.metrics.psnr import psnr
from hybrid.measure.reference import REFERENCE_SEED, reference
from pathtrace.trace.tracer import Tracer

# Frames with other gazes, before anything is measured, for which the kernels are compiled.
_WARM_UP = 6
# The reference has full samples this many pixels beyond the disc: its denoiser would spread noise from there.
_MARGIN = 32
# Samples per pixel of the reference elsewhere.
_ELSEWHERE = 4
# Seconds after which frames may take longer for better quality.
_HURRIED = 1.0


def bench_still(
    renderer: LiveRenderer,
    settings: FrameSettings,
    seconds: float,
    reference_spp: int,
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    """PSNR of the disc before blending, in sRGB against a reference, for each frame.

    Args:
        renderer: of the scene.
        settings: of the frames, with camera and gaze.
        seconds: for which nothing moves.
        reference_spp: samples per pixel of the reference in the disc.
        progress: called with seconds done and seconds in total.

    Returns:
        `frames`, each with `seconds`, `spp` and `psnr`; `reference_psnr` of the reference itself against the
        truth; `most_fall`, the largest loss in dB of a frame against the best one before it, once frames no
        longer hurry.
    """
    gaze = settings.gaze
    camera, _ = settings.resolved(renderer.scene.camera)
    loop = FrameLoop(FrameSource(renderer), lambda request: [])
    for number in range(_WARM_UP):
        loop.make(Request(replace(settings, gaze=Gaze(1 - gaze.x, 0.01 * number))))
    renderer.forget()
    seen = _watched(loop, Request(settings), seconds, progress)
    disc = np.zeros((camera.height, camera.width), dtype=bool)
    disc.ravel()[seen[-1].pixels] = True
    truth = _reference(renderer.tracer, camera, disc, reference_spp)
    frames = [
        {"seconds": one.seconds, "spp": one.spp, "psnr": psnr(one.radiance, truth.radiance)} for one in seen
    ]
    progress(int(seconds) + 1, int(seconds) + 1)
    return {
        "scene": renderer.scene.name,
        "gaze": [gaze.x, gaze.y],
        "reference_spp": reference_spp,
        "reference_psnr": truth.psnr,
        "most_fall": most_fall(frames),
        "frames": frames,
    }


def most_fall(frames: list[dict[str, float]]) -> float:
    """Largest loss in dB of a frame against the best one before it; frames that hurry do not count.

    Args:
        frames: with `seconds` and `psnr`, in order.
    """
    best = np.maximum.accumulate([frame["psnr"] for frame in frames])
    falls = [
        top - frame["psnr"] for top, frame in zip(best, frames, strict=True) if frame["seconds"] > _HURRIED
    ]
    return float(max(falls, default=0.0))


@dataclass(frozen=True)
class _Seen:
    """One frame.

    Attributes:
        seconds: from the first request until it was complete.
        spp: mean samples per pixel of the disc.
        pixels: (D,) of the disc.
        radiance: (D, 3) of the disc.
    """

    seconds: float
    spp: float
    pixels: NDArray[np.uint32]
    radiance: Image


@dataclass(frozen=True)
class _Truth:
    """Reference radiance of a disc (D, 3), and its own PSNR."""

    radiance: Image
    psnr: float


def _watched(
    loop: FrameLoop, request: Request, seconds: float, progress: Callable[[int, int], None]
) -> list[_Seen]:
    """All frames of a request within a time."""
    seen: list[_Seen] = []
    start = time.perf_counter()
    while not seen or seen[-1].seconds < seconds:
        shown = loop.make(request)
        frame = shown.frame
        at = time.perf_counter() - start
        pixels = np.array(frame.fovea.disc.pixels)
        radiance = frame.of_disc(frame.fovea.radiance).reshape(-1, 3)[pixels]
        seen.append(_Seen(at, shown.spp, pixels, radiance))
        progress(int(seen[-1].seconds), int(seconds) + 1)
    return seen


def _reference(tracer: Tracer, camera: Camera, disc: NDArray[np.bool_], spp: int) -> _Truth:
    """The reference of a disc (H, W)."""
    counts = np.where(binary_dilation(disc, iterations=_MARGIN), spp, min(spp, _ELSEWHERE))
    found = reference(tracer, camera, counts.ravel(), REFERENCE_SEED)
    return _Truth(found.radiance[disc], found.psnr(disc))
