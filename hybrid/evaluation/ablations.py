"""Ablations: hybrid frames without one of their parts, which tell what that part brings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compose.fovea.foveation import FoveaMode, Placement
from hybrid.evaluation.methods import Family, HybridMethod
from hybrid.render.expected_errors import errors_of
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import MOST_SPP, FrameSettings
from pathtrace.trace import Integrator


def ablations(renderer: Renderer, settings: FrameSettings) -> dict[str, Family]:
    """Hybrid frames with all of their parts but one, by name; UserError if the forest lacks their layers.

    What the settings or the forest lack is left out, except paths where they are needed: frames that trace in
    the disc get them. Frames have the whole number of samples per pixel whose rays, in the camera of the
    settings, come nearest to those asked for. Frames that follow no others have no history to leave out.
    """
    used, (low, high) = settings.used_integrator, renderer.periphery.layers_of(settings)
    changed: dict[str, FrameSettings] = {}
    if settings.fovea is FoveaMode.FUSED:
        changed["without fusion"] = replace(settings, fovea=FoveaMode.DENOISED)
    if settings.fovea is not FoveaMode.RAW:
        changed["without denoising"] = replace(settings, fovea=FoveaMode.RAW, integrator=used)
    if low < high and not settings.is_continuous:
        changed["without levels"] = replace(settings, layers=(high, high))
    if settings.acuity_model != "none":
        changed["without the acuity model"] = replace(settings, acuity_model="none")
    if settings.fill:
        changed["without infill"] = replace(settings, fill=False)
    if used is Integrator.CACHED:
        changed["without the cache"] = replace(settings, integrator=Integrator.PATH)
    if settings.traces_cells:
        changed["with paths in the disc"] = replace(settings, paths=Placement.DISC)
    elif settings.fovea is not FoveaMode.RAW and errors_of(renderer.periphery.forest) is not None:
        changed["with paths where needed"] = replace(settings, paths=Placement.WHERE_NEEDED)
    return {f"hybrid, {name}": _family(renderer, one) for name, one in changed.items()}


def _family(renderer: Renderer, settings: FrameSettings) -> Family:
    camera = settings.camera or renderer.scene.camera
    least = HybridMethod(renderer, replace(settings, spp=1)).rays(camera, settings.gaze)

    def family(rays: float) -> HybridMethod:
        # Without a disc, all numbers are as near.
        spp = round(float(np.clip(rays / least, 1, MOST_SPP))) if least else 1
        return HybridMethod(renderer, replace(settings, spp=spp))

    return family
