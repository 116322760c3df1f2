"""The same ways to make a frame at what another one costs: at equal rays, and at equal time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.measure.timing import jittered
from hybrid.methods.method import Method
from hybrid.methods.path_traced import Enlarged, FullTrace, Rmfr
from pathtrace.trace.tracer import Tracer

# FPC's own setting of RMFR.
_FPC_F, _FPC_SIGMA = 0.1, 2.6
# Frames timed for one look at a peer's cost, after one that is not counted; looks until the cost is met, and
# how nearly it has to be.
_FRAMES, _LOOKS, NEAR = 5, 12, 0.03


@dataclass(frozen=True)
class WarpTuning:
    """What is left to choose of RMFR at a given number of rays."""

    f: float
    spp: int
    denoised: bool


@dataclass(frozen=True)
class Tuning:
    """What is left to choose of peers at a given number of rays; found on views that are not measured.

    Attributes:
        frame, fovea: of RMFR, as it is best for the whole frame and for the fovea.
        enlarged_spp: of the enlarged frame.
    """

    frame: WarpTuning
    fovea: WarpTuning
    enlarged_spp: int

    @staticmethod
    def restored(found: dict[str, Any]) -> Tuning:
        """From what `asdict` has made of one."""
        return Tuning(WarpTuning(**found["frame"]), WarpTuning(**found["fovea"]), found["enlarged_spp"])


# From paths per pixel of the frame to a peer that takes about as many.
Family = Callable[[float], Method]


def families(tracer: Tracer, tuning: Tuning) -> dict[str, Family]:
    """All peers that trace paths, by name."""
    found: dict[str, Family] = {
        "full": lambda rays: FullTrace(tracer, max(1.0, rays), denoised=False),
        "full, denoised": lambda rays: FullTrace(tracer, max(1.0, rays), denoised=True),
        "enlarged": lambda rays: enlarged(tracer, 1, rays, denoised=False),
        "enlarged, denoised": lambda rays: enlarged(tracer, tuning.enlarged_spp, rays, denoised=True),
        "rmfr": lambda rays: Rmfr(tracer, _FPC_F, _FPC_SIGMA, max(1.0, rays * _FPC_SIGMA**2), denoised=False),
        "rmfr, tuned": lambda rays: warped(tracer, tuning.frame, rays),
    }
    if tuning.fovea != tuning.frame:
        found["rmfr, tuned for the fovea"] = lambda rays: warped(tracer, tuning.fovea, rays)
    return found


def enlarged(tracer: Tracer, least: int, rays: float, denoised: bool) -> Enlarged:
    """An enlarged frame with so many rays per pixel, and at least so many samples of each of its places."""
    spp = _whole(least, rays)
    return Enlarged(tracer, rays / spp, spp, denoised)


def warped(tracer: Tracer, tuning: WarpTuning, rays: float) -> Rmfr:
    """RMFR with so many rays per pixel, and at least as many samples of each place as it is tuned to."""
    spp = _whole(tuning.spp, rays)
    return Rmfr(tracer, tuning.f, float(np.sqrt(spp / rays)), spp, tuning.denoised)


def _whole(least: int, rays: float) -> int:
    """Samples of each place of a picture that has fewer places than the frame, or as many at most."""
    return max(least, math.ceil(rays))


def at_equal_time(family: Family, ours: Method, camera: Camera, gaze: Gaze, rays: float) -> float | None:
    """The rays per pixel at which the peer of a family comes nearest to our time without taking longer.

    Args:
        family: whose cost grows with its rays.
        ours: what its cost is compared with.
        camera, gaze: what is rendered.
        rays: to start from.

    Returns:
        The rays, None where even the family's cheapest peer takes longer.
    """
    known: dict[str, float] = {}
    within: Look | None = None
    beyond: Look | None = None
    for _ in range(_LOOKS):
        method = family(rays)
        key = str(method.settings)
        if key not in known:
            known[key] = relative_time(method, ours, camera, gaze)
        look = Look(rays, known[key])
        if look.time <= 1 + NEAR:
            within = look
        else:
            beyond = look
        if within is not None and within.time >= 1 - NEAR:
            break
        rays = _guess(within, beyond)
    return None if within is None else within.rays


@dataclass(frozen=True)
class Look:
    """What a peer with so many rays per pixel took, in our time."""

    rays: float
    time: float


def _guess(within: Look | None, beyond: Look | None) -> float:
    """Rays that should meet our time, from the nearest looks on both sides of it."""
    if within is None or beyond is None:
        look = within or beyond
        assert look is not None
        # Costs grow more slowly than rays: a step further than they would have it soon has both sides.
        steps = (1.5, 8.0) if beyond is None else (0.125, 0.7)
        return look.rays * float(np.clip(look.time**-1.5, *steps))
    span = (1 - within.time) / (beyond.time - within.time)
    # Where samples come as whole numbers the line between two looks leads nowhere; the middle does.
    return within.rays + (beyond.rays - within.rays) * float(np.clip(span, 0.2, 0.8))


def relative_time(method: Method, ours: Method, camera: Camera, gaze: Gaze) -> float:
    """A peer's time in ours: medians of frames in turn, since the machine's speed drifts."""
    times: tuple[list[float], list[float]] = ([], [])
    for seed in range(_FRAMES + 1):
        for place, (way, found) in enumerate(zip((method, ours), times, strict=True)):
            found.append(way.render(jittered(camera, 2 * seed + place), gaze, seed).milliseconds["total"])
    # The first ones warm up.
    theirs, of_ours = (float(np.median(found[1:])) for found in times)
    return theirs / of_ours
