"""What a peer is set to is chosen on views that are not measured: nobody shall be beaten at a bad setting."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import numpy as np

from compose.camera.camera import Camera
from compose.fovea.region import Foveation
from compose.image.colour import Image
from hybrid.evaluation.budgets import Tuning, WarpTuning, enlarged, warped
from hybrid.measure.metrics.ssim import ssim_map, valid_mean
from hybrid.measure.regions import regions
from hybrid.methods.method import Method
from pathtrace.trace.tracer import Tracer

_F = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6)
_SPP = (1, 2, 4)


def tuned(
    tracer: Tracer,
    views: list[Camera],
    references: list[Image],
    foveation: Foveation,
    rays: float,
    progress: Callable[[int, int], None],
) -> Tuning:
    """The settings with the best mean SSIM, of the whole frame and of the fovea, at so many rays per pixel.

    Args:
        tracer: of the scene.
        views, references: to tune on.
        foveation: gaze and radii.
        rays: per pixel of the frame.
        progress: called with settings tried and settings in all.
    """
    counts = _at_least(rays)
    warps = [WarpTuning(*key) for key in product(_F, counts, (False, True))]
    baselines: list[Method] = [warped(tracer, tuning, rays) for tuning in warps]
    baselines += [enlarged(tracer, spp, rays, denoised=True) for spp in counts]
    masks = [regions(foveation, truth)["foveal"].mask.astype(np.float32) for truth in references]
    whole, foveal = [], []
    for number, baseline in enumerate(baselines):
        images = [baseline.render(view, foveation.gaze, seed).image for seed, view in enumerate(views)]
        maps = [ssim_map(image, truth) for image, truth in zip(images, references, strict=True)]
        whole.append(np.mean([valid_mean(found) for found in maps]))
        foveal.append(np.mean([valid_mean(*found) for found in zip(maps, masks, strict=True)]))
        progress(number + 1, len(baselines))
    frame, fovea = (warps[int(np.argmax(scores[: len(warps)]))] for scores in (whole, foveal))
    return Tuning(frame, fovea, counts[int(np.argmax(whole[len(warps) :]))])


def _at_least(rays: float) -> list[int]:
    """Samples of each place: with fewer than the rays of a pixel, there would be more places than pixels."""
    return [spp for spp in _SPP if spp >= rays] or [math.ceil(rays)]
