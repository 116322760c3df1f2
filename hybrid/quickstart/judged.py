"""Quality of hybrid frames in views that nothing was fitted to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compose.camera.view import View
from compose.image.colour import Image
from hybrid.frame.frame import Frame
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import EXTRA_AOVS, FrameSettings
from hybrid.measure.metrics.registration import registration_px
from hybrid.measure.metrics.similarity import quality
from hybrid.measure.reference import REFERENCE_SEED
from pathtrace.dataset.rendering import render_frame

Range = tuple[float, float]


@dataclass(frozen=True)
class JudgedView:
    """A view with what is shown of it.

    Attributes:
        frame: the hybrid frame, with all AOVs.
        reference: (H, W, 3) radiance of denoised path tracing.
    """

    frame: Frame
    reference: Image

    @property
    def splats(self) -> Image:
        """(H, W, 3) radiance of the splats alone."""
        return self.frame.more["splat"]


def judged_views(
    renderer: Renderer,
    views: list[View],
    settings: FrameSettings,
    reference_spp: int,
    seed: int,
    progress: Callable[[int, int], None],
) -> list[JudgedView]:
    """The frames of some views, and what they are compared with.

    Args:
        renderer: of the scene.
        views: what they show.
        settings: of the frames.
        reference_spp: samples per pixel of the references.
        seed: same seed, same images on the same machine.
        progress: called with views done and views in total.
    """
    found = []
    for number, view in enumerate(views):
        progress(number, len(views))
        own = replace(settings, camera=view.camera, time=view.time, aovs=EXTRA_AOVS)
        renderer.scene.show(view.time)
        truth_seed = seed + REFERENCE_SEED + number
        truth = render_frame(renderer.tracer, view.camera, reference_spp, truth_seed).radiance
        found.append(JudgedView(renderer.frame(own, seed + number), truth))
    progress(len(views), len(views))
    return found


def judged_quality(views: list[JudgedView]) -> dict[str, Any]:
    """Entries of result.json: means over the views, and the least and the greatest value of a view.

    Returns:
        `views`, their number; `hybrid` and `splats_alone`, psnr in dB and ssim; `registration_px`, unless no
        view has a window with enough texture; and of each of these its `..._range`.
    """
    found: dict[str, Any] = {"views": len(views)}
    found |= _summary("hybrid", [quality(one.frame.composite, one.reference) for one in views])
    found |= _summary("splats_alone", [quality(one.splats, one.reference) for one in views])
    shifts = [registration_px(one.splats, one.reference) for one in views]
    known = [shift for shift in shifts if shift is not None]
    if known:
        found |= {"registration_px": float(np.mean(known)), "registration_px_range": _range(known)}
    return found


def _summary(name: str, rows: list[dict[str, float]]) -> dict[str, Any]:
    """Mean and range of each metric."""
    values = {metric: [row[metric] for row in rows] for metric in rows[0]}
    return {
        name: {metric: float(np.mean(each)) for metric, each in values.items()},
        f"{name}_range": {metric: _range(each) for metric, each in values.items()},
    }


def _range(values: list[float]) -> Range:
    return min(values), max(values)
