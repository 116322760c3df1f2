"""The path-traced baselines by name, at any number of rays per pixel, and their free settings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from compose.fovea.foveation import Foveation
from hybrid.evaluation.baselines_disc import DiscOverEnlarged
from hybrid.evaluation.baselines_guided import Guided
from hybrid.evaluation.baselines_traced import FullTrace, enlarged, spp_and_share
from hybrid.evaluation.baselines_warped import Rmfr
from hybrid.evaluation.methods import Family
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.trace import Integrator
from pathtrace.trace.tracer import Tracer

# Foveated Path Culling's (FPC's) settings of RMFR.
_FPC_F, _FPC_SIGMA = 0.1, 2.6
# Path depth from which Russian roulette ends paths early.
_EARLY = 1


@dataclass(frozen=True)
class WarpTuning:
    """Settings of RMFR that remain free at a given number of rays, with at least `spp` per buffer pixel."""

    f: float
    spp: int
    denoised: bool


@dataclass(frozen=True)
class Tuning:
    """Settings of the baselines that remain free at a given number of rays.

    Attributes:
        frame, fovea: the best ones of RMFR for the whole frame and for the fovea.
        enlarged_spp: least samples per pixel of denoised frames of fewer pixels.
        disc_share: share of the rays in the disc over an enlarged frame.
    """

    frame: WarpTuning
    fovea: WarpTuning
    enlarged_spp: int
    disc_share: float

    @staticmethod
    def restored(found: dict[str, Any]) -> Tuning:
        """The tuning from the result of `asdict`."""
        warps = {name: WarpTuning(**found[name]) for name in ("frame", "fovea")}
        return Tuning(**{**found, **warps})


def families(renderer: Renderer, settings: FrameSettings, tuning: Tuning) -> dict[str, Family]:
    """All path-traced baselines by name, for hybrid frames with some settings; RMFR with FPC's, and tuned.

    They trace paths as the hybrid frames do, except those whose names say how.
    """
    tracer, spp = renderer.tracer_of(settings.used_integrator), tuning.enlarged_spp
    found: dict[str, Family] = {
        "full": lambda rays: FullTrace(tracer, max(1.0, rays), denoised=False),
        "full, denoised": _full(tracer),
        **_otherwise_traced(renderer, settings),
        "enlarged": lambda rays: enlarged(tracer, 1, rays, denoised=False),
        "enlarged, denoised": lambda rays: enlarged(tracer, spp, rays, denoised=True),
        "enlarged, light x albedo": _guided(tracer, spp, demodulated=True, edges=False),
        "enlarged, edge-aware": _guided(tracer, spp, demodulated=False, edges=True),
        "enlarged, light x albedo, edge-aware": _guided(tracer, spp, demodulated=True, edges=True),
        "disc over enlarged": lambda rays: disc_over(
            tracer, settings.foveation, spp, tuning.disc_share, rays
        ),
        "rmfr": lambda rays: Rmfr(tracer, max(1.0, rays * _FPC_SIGMA**2), False, _FPC_F, _FPC_SIGMA),
        "rmfr, tuned": lambda rays: warped(tracer, tuning.frame, rays),
    }
    if tuning.fovea != tuning.frame:
        found["rmfr, tuned for the fovea"] = lambda rays: warped(tracer, tuning.fovea, rays)
    return found


def _otherwise_traced(renderer: Renderer, settings: FrameSettings) -> dict[str, Family]:
    """Denoised full frames of the other integrator; and of unbiased paths that roulette may end early."""
    other = Integrator.CACHED if settings.used_integrator is Integrator.PATH else Integrator.PATH
    tracers = {other.value: renderer.tracer_of(other)}
    if renderer.scene.roulette_depth > _EARLY:
        tracers[f"{Integrator.PATH.value}, early roulette"] = Tracer(renderer.scene, roulette_depth=_EARLY)
    return {f"full, {name}, denoised": _full(tracer) for name, tracer in tracers.items()}


def _full(tracer: Tracer) -> Family:
    return lambda rays: FullTrace(tracer, max(1.0, rays), denoised=True)


def _guided(tracer: Tracer, least_spp: int, demodulated: bool, edges: bool) -> Family:
    def family(rays: float) -> Guided:
        spp, share = spp_and_share(least_spp, rays)
        return Guided(tracer, spp, True, share, demodulated, edges)

    return family


def disc_over(
    tracer: Tracer, foveation: Foveation, least_spp: int, share: float, rays: float
) -> DiscOverEnlarged:
    """The disc over an enlarged frame, with that many rays per frame pixel, a share of them in the disc."""
    return DiscOverEnlarged(tracer, least_spp, True, foveation, rays, share)


def warped(tracer: Tracer, tuning: WarpTuning, rays: float) -> Rmfr:
    """RMFR with that many rays per frame pixel, and at least the tuned samples per buffer pixel."""
    spp, share = spp_and_share(tuning.spp, rays)
    return Rmfr(tracer, spp, tuning.denoised, tuning.f, 1 / math.sqrt(share))
