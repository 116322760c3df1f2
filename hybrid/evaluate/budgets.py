"""The same ways to make a frame at what another one costs: at equal rays, and at equal time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from compose.view import Camera, Gaze
from hybrid.evaluate.peers import Enlarged, FullTrace, Peer, Warped
from pathtrace.tracer import Tracer

# FPC's own setting of RMFR.
_FPC_F, _FPC_SIGMA = 0.1, 2.6
# Frames timed for one look at a peer's cost, after one that is not counted; looks until the cost is met, and
# how nearly it has to be.
_FRAMES, _LOOKS, NEAR = 5, 12, 0.03


@dataclass(frozen=True)
class Tuning:
    """What is left to choose of peers at a given number of rays; found on views that are not measured.

    Attributes:
        f, spp, denoised: of RMFR.
        enlarged_spp: of the enlarged frame.
    """

    f: float
    spp: int
    denoised: bool
    enlarged_spp: int


# From paths per pixel of the frame to a peer that takes about as many.
Family = Callable[[float], Peer]


def families(tracer: Tracer, tuning: Tuning) -> dict[str, Family]:
    """All peers that trace paths, by name."""

    def full(denoised: bool) -> Family:
        return lambda rays: FullTrace(tracer, max(1, int(rays)), denoised)

    def enlarged(denoised: bool) -> Family:
        spp = tuning.enlarged_spp if denoised else 1
        return lambda rays: Enlarged(tracer, rays / spp, spp, denoised)

    return {
        "full": full(False),
        "full, denoised": full(True),
        "enlarged": enlarged(False),
        "enlarged, denoised": enlarged(True),
        "rmfr": lambda rays: Warped(
            tracer, _FPC_F, _FPC_SIGMA, max(1, int(rays * _FPC_SIGMA**2)), denoised=False
        ),
        "rmfr, tuned": lambda rays: Warped(
            tracer, tuning.f, float(np.sqrt(tuning.spp / rays)), tuning.spp, tuning.denoised
        ),
    }


def at_equal_time(
    family: Family, camera: Camera, gaze: Gaze, milliseconds: float, rays: float
) -> float | None:
    """The rays per pixel at which the peer of a family comes nearest to a time without taking longer.

    Args:
        family: whose cost grows with its rays.
        camera, gaze: what is rendered.
        milliseconds: to be met.
        rays: to start from.

    Returns:
        The rays, None where even the family's cheapest peer takes longer.
    """
    known: dict[str, float] = {}
    within: Look | None = None
    beyond: Look | None = None
    for _ in range(_LOOKS):
        peer = family(rays)
        key = str(peer.settings)
        if key not in known:
            known[key] = median_time(peer, camera, gaze)
        look = Look(rays, known[key])
        if look.milliseconds <= milliseconds * (1 + NEAR):
            within = look
        else:
            beyond = look
        if within is not None and within.milliseconds >= milliseconds * (1 - NEAR):
            break
        rays = _guess(within, beyond, milliseconds)
    return None if within is None else within.rays


@dataclass(frozen=True)
class Look:
    """What a peer with so many rays per pixel took."""

    rays: float
    milliseconds: float


def _guess(within: Look | None, beyond: Look | None, milliseconds: float) -> float:
    """Rays that should meet a time, from the nearest looks on both sides of it."""
    if within is None or beyond is None:
        look = within or beyond
        assert look is not None
        # Costs grow more slowly than rays: a step further than they would have it soon has both sides.
        share = milliseconds / look.milliseconds
        return look.rays * float(np.clip(share**1.5, *((1.5, 8.0) if beyond is None else (0.125, 0.7))))
    span = (milliseconds - within.milliseconds) / (beyond.milliseconds - within.milliseconds)
    # Where samples come as whole numbers the line between two looks leads nowhere; the middle does.
    return within.rays + (beyond.rays - within.rays) * float(np.clip(span, 0.2, 0.8))


def median_time(peer: Peer, camera: Camera, gaze: Gaze) -> float:
    """Milliseconds of a frame, after one that warms up."""
    times = [peer.make(camera, gaze, seed).milliseconds["total"] for seed in range(_FRAMES + 1)]
    return float(np.median(times[1:]))
