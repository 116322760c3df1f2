"""Baselines at the cost of the hybrid frame: the rays at which one takes as long, and its best settings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from compose.image.colour import Image
from hybrid.base.progress import Steps
from hybrid.evaluation.baselines import Tuning, WarpTuning, disc_over, warped
from hybrid.evaluation.baselines_traced import enlarged
from hybrid.evaluation.methods import Family, Method
from hybrid.evaluation.results import TOLERANCE
from hybrid.measure.frame_times import jittered_view, path_around, ratio_interval, ratio_of_medians
from hybrid.measure.image_metrics import has_valid, regions, ssim_map, valid_mean
from pathtrace.trace.tracer import Tracer

# Trials at most.
_TRIALS = 12
# Frames of each method per trial, after one that is not measured: in steps of the first number, until the
# time is known well enough to decide, at most the second one.
_STEP, _MOST_FRAMES = 6, 60
# Between two frames' steps along the gaze path: few frames cover all of it as well.
_STRIDE = 23
# Rays per pixel of a baseline, and how long it takes with them, relative to the hybrid frame.
Trial = tuple[float, float]
# What is tried: f of RMFR's mapping, samples per pixel, and shares of the rays in a disc.
_F = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6)
_SPP = (1, 2, 4)
_SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8)


def at_equal_time(
    family: Family, ours: Method, views: Sequence[View], gaze: Gaze, rays: float
) -> float | None:
    """Rays per pixel at which a baseline comes closest to our time without exceeding it by over 3 %.

    The time of the baseline's family must grow with its rays, of which `rays` are tried first. Frames go
    through the views in turn, their gazes along a path around `gaze`. None if every trial took longer.
    """
    known: dict[str, float] = {}
    within: Trial | None = None
    beyond: Trial | None = None
    for _ in range(_TRIALS):
        method = family(rays)
        # Whole samples: other rays may well be the same settings.
        key = str(method.settings)
        if key not in known:
            known[key] = relative_time(method, ours, views, gaze)
        if known[key] <= 1 + TOLERANCE:
            within = rays, known[key]
        else:
            beyond = rays, known[key]
        if within is not None and within[1] >= 1 - TOLERANCE:
            break
        rays = _next_guess(within, beyond)
    return None if within is None else within[0]


def _next_guess(within: Trial | None, beyond: Trial | None) -> float:
    """Rays that should meet our time, from the last trials within and beyond it."""
    if within is not None and beyond is not None:
        span = (1 - within[1]) / (beyond[1] - within[1])
        # Kept away from both ends: with whole samples, a line between two trials may lead back to one.
        return within[0] + (beyond[0] - within[0]) * float(np.clip(span, 0.2, 0.8))
    trial = within or beyond
    assert trial is not None
    # Time grows more slowly than rays: steps that are longer than needed soon have trials on both sides.
    steps = (1.5, 8.0) if beyond is None else (0.125, 0.7)
    return trial[0] * float(np.clip(trial[1] ** -1.5, *steps))


def relative_time(method: Method, ours: Method, views: Sequence[View], gaze: Gaze) -> float:
    """A method's time over ours: medians of frames rendered in turns, because the machine's speed drifts.

    Views, gaze and camera change from frame to frame. Frames are added until the ratio's 95 % confidence
    interval decides whether the times are equal, or is no wider than what counts as equal.
    """
    times: tuple[list[float], list[float]] = ([], [])
    path = path_around(gaze, _MOST_FRAMES)
    for seed in range(_MOST_FRAMES + 1):
        view, at = views[seed % len(views)], path[seed * _STRIDE % _MOST_FRAMES]
        for number, (one, found) in enumerate(zip((method, ours), times, strict=True)):
            found.append(one.render(jittered_view(view, 2 * seed + number), at, seed).milliseconds["total"])
        # The first frames warm up.
        if seed and seed % _STEP == 0:
            low, high = ratio_interval(times[0][1:], times[1][1:])
            if low > 1 + TOLERANCE or high < 1 - TOLERANCE or high - low <= TOLERANCE:
                break
    return ratio_of_medians(times[0][1:], times[1][1:])


def tuned(
    tracer: Tracer,
    views: list[View],
    references: list[Image],
    foveation: Foveation,
    rays: float,
    progress: Steps,
) -> Tuning:
    """The settings with the highest mean SSIM, of the whole frame and of the fovea, at a number of rays.

    They are tuned on views with references (H, W, 3), linear radiance; rays are per pixel of the frame. The
    disc over an enlarged frame gets the share of the rays with the highest sum of both.
    """
    # With fewer samples per pixel than `rays`, the smaller image would be larger than the frame.
    counts = [spp for spp in _SPP if spp >= rays] or [math.ceil(rays)]
    warps = [WarpTuning(*settings) for settings in product(_F, counts, (False, True))]
    total = len(warps) + len(counts) + len(_SHARES)
    foveas = [regions(foveation, truth)["foveal"].mask.astype(np.float32) for truth in references]
    # All pixels count where SSIM has no value in the fovea.
    weights = [fovea if has_valid(fovea) else None for fovea in foveas]
    done = 0

    def scores(baselines: Iterable[Method]) -> NDArray[np.float64]:
        """(baselines, 2) mean SSIM of the whole frame and of the fovea."""
        nonlocal done
        found = []
        for baseline in baselines:
            images = [baseline.render(view, foveation.gaze, seed).image for seed, view in enumerate(views)]
            maps = [ssim_map(image, truth) for image, truth in zip(images, references, strict=True)]
            pairs = zip(maps, weights, strict=True)
            found.append([[valid_mean(one), valid_mean(one, weight)] for one, weight in pairs])
            done += 1
            progress(done, total)
        return np.mean(found, axis=1)

    frame, fovea = (
        warps[best] for best in scores(warped(tracer, tuning, rays) for tuning in warps).argmax(axis=0)
    )
    smaller = scores(enlarged(tracer, spp, rays, denoised=True) for spp in counts)
    spp = counts[int(smaller[:, 0].argmax())]
    split = scores(disc_over(tracer, foveation, spp, share, rays) for share in _SHARES)
    return Tuning(frame, fovea, spp, _SHARES[int(split.sum(axis=1).argmax())])
