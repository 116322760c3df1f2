"""Families of path-traced baselines: each gives a method for any number of rays per pixel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid.methods.method import Method
from hybrid.methods.path_traced import Enlarged, FullTrace, Rmfr
from pathtrace.trace.tracer import Tracer

# Foveated Path Culling's (FPC's) settings of RMFR, rectangular mapping-based foveated rendering.
_FPC_F, _FPC_SIGMA = 0.1, 2.6


@dataclass(frozen=True)
class WarpTuning:
    """Settings of RMFR that remain free at a given number of rays.

    Attributes:
        f: of the mapping (hybrid.methods.warp).
        spp: least samples per pixel of the buffer.
        denoised: whether the buffer is denoised.
    """

    f: float
    spp: int
    denoised: bool


@dataclass(frozen=True)
class Tuning:
    """Settings of the baselines that remain free at a given number of rays.

    Attributes:
        frame, fovea: the best ones of RMFR for the whole frame and for the fovea.
        enlarged_spp: least samples per pixel of the denoised enlarged frame.
    """

    frame: WarpTuning
    fovea: WarpTuning
    enlarged_spp: int

    @staticmethod
    def restored(found: dict[str, Any]) -> Tuning:
        """The tuning from the result of `asdict`."""
        return Tuning(WarpTuning(**found["frame"]), WarpTuning(**found["fovea"]), found["enlarged_spp"])


# From paths per pixel of the frame to a method that takes about as many.
Family = Callable[[float], Method]


def families(tracer: Tracer, tuning: Tuning) -> dict[str, Family]:
    """All path-traced baselines by name; RMFR with FPC's settings, and tuned."""
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


def enlarged(tracer: Tracer, least_spp: int, rays: float, denoised: bool) -> Enlarged:
    """The enlarged frame with that many rays per frame pixel, and at least `least_spp` per traced pixel."""
    spp = _whole_spp(least_spp, rays)
    return Enlarged(tracer, rays / spp, spp, denoised)


def warped(tracer: Tracer, tuning: WarpTuning, rays: float) -> Rmfr:
    """RMFR with that many rays per frame pixel, and at least the tuned samples per buffer pixel."""
    spp = _whole_spp(tuning.spp, rays)
    return Rmfr(tracer, tuning.f, float(np.sqrt(spp / rays)), spp, tuning.denoised)


def _whole_spp(least_spp: int, rays: float) -> int:
    """Samples per pixel of a smaller image: enough that it has no more pixels than the frame."""
    return max(least_spp, math.ceil(rays))
