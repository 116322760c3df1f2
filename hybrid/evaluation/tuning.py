"""Tunes baselines on views that are not measured, so that none is compared at a bad setting."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.typing import NDArray

from compose.camera.view import View
from compose.fovea.region import Foveation
from compose.image.colour import Image
from hybrid.evaluation.families import Tuning, WarpTuning, enlarged, warped
from hybrid.measure.metrics.ssim import has_valid, ssim_map, valid_mean
from hybrid.measure.regions import regions
from hybrid.methods.method import Method
from pathtrace.trace.tracer import Tracer

# What is tried: f of RMFR's mapping, and samples per pixel.
_F = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6)
_SPP = (1, 2, 4)


def tuned(
    tracer: Tracer,
    views: list[View],
    references: list[Image],
    foveation: Foveation,
    rays: float,
    progress: Callable[[int, int], None],
) -> Tuning:
    """The settings with the highest mean SSIM, of the whole frame and of the fovea, at a number of rays.

    Args:
        tracer: of the scene.
        views, references: to tune on; references are (H, W, 3) radiance.
        foveation: gaze and radii.
        rays: per pixel of the frame.
        progress: called with settings tried and settings in total.
    """
    counts = _sample_counts(rays)
    warps = [WarpTuning(*settings) for settings in product(_F, counts, (False, True))]
    baselines: list[Method] = [warped(tracer, tuning, rays) for tuning in warps]
    baselines += [enlarged(tracer, spp, rays, denoised=True) for spp in counts]
    masks = [_foveal(foveation, truth) for truth in references]
    whole, foveal = [], []
    for number, baseline in enumerate(baselines):
        images = [baseline.render(view, foveation.gaze, seed).image for seed, view in enumerate(views)]
        maps = [ssim_map(image, truth) for image, truth in zip(images, references, strict=True)]
        whole.append(np.mean([valid_mean(one) for one in maps]))
        foveal.append(np.mean([valid_mean(one, mask) for one, mask in zip(maps, masks, strict=True)]))
        progress(number + 1, len(baselines))
    frame, fovea = (warps[int(np.argmax(scores[: len(warps)]))] for scores in (whole, foveal))
    return Tuning(frame, fovea, counts[int(np.argmax(whole[len(warps) :]))])


def _foveal(foveation: Foveation, truth: Image) -> NDArray[np.float32] | None:
    """(H, W) the fovea's pixels as weights of SSIM; None, for all pixels, if SSIM has no value there."""
    mask = regions(foveation, truth)["foveal"].mask.astype(np.float32)
    return mask if has_valid(mask) else None


def _sample_counts(rays: float) -> list[int]:
    """Samples per pixel to try; with fewer than `rays`, the smaller image would be larger than the frame."""
    return [spp for spp in _SPP if spp >= rays] or [math.ceil(rays)]
