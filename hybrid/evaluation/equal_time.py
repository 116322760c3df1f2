"""The number of rays at which a baseline takes as long as the hybrid frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.evaluation.families import Family
from hybrid.measure.timing import jittered
from hybrid.methods.method import Method

# Costs count as equal within this share.
TOLERANCE = 0.03
# Frames of each method per trial, after one that is not measured; and trials at most.
_FRAMES, _TRIALS = 5, 12


@dataclass(frozen=True)
class Trial:
    """How long a baseline takes with that many rays per pixel, relative to the hybrid frame."""

    rays: float
    time: float


def at_equal_time(family: Family, ours: Method, camera: Camera, gaze: Gaze, rays: float) -> float | None:
    """Rays per pixel at which a baseline comes closest to our time without exceeding it by over 3 %.

    Args:
        family: of the baseline; its time must grow with its rays.
        ours: the method whose time is to be met.
        camera, gaze: what is rendered.
        rays: to start from.

    Returns:
        The rays; None if every trial took longer.
    """
    known: dict[str, float] = {}
    within: Trial | None = None
    beyond: Trial | None = None
    for _ in range(_TRIALS):
        method = family(rays)
        # Whole samples: other rays may well be the same settings.
        key = str(method.settings)
        if key not in known:
            known[key] = relative_time(method, ours, camera, gaze)
        trial = Trial(rays, known[key])
        if trial.time <= 1 + TOLERANCE:
            within = trial
        else:
            beyond = trial
        if within is not None and within.time >= 1 - TOLERANCE:
            break
        rays = _next_guess(within, beyond)
    return None if within is None else within.rays


def _next_guess(within: Trial | None, beyond: Trial | None) -> float:
    """Rays that should meet our time, from the last trials within and beyond it."""
    if within is None or beyond is None:
        trial = within or beyond
        assert trial is not None
        # Time grows more slowly than rays: steps that are longer than needed soon have trials on both sides.
        steps = (1.5, 8.0) if beyond is None else (0.125, 0.7)
        return trial.rays * float(np.clip(trial.time**-1.5, *steps))
    span = (1 - within.time) / (beyond.time - within.time)
    # Kept away from both ends: with whole samples, a line between two trials may lead back to one of them.
    return within.rays + (beyond.rays - within.rays) * float(np.clip(span, 0.2, 0.8))


def relative_time(method: Method, ours: Method, camera: Camera, gaze: Gaze) -> float:
    """A method's time over ours: medians of frames rendered in turns, because the machine's speed drifts."""
    times: tuple[list[float], list[float]] = ([], [])
    for seed in range(_FRAMES + 1):
        for number, (one, found) in enumerate(zip((method, ours), times, strict=True)):
            found.append(one.render(jittered(camera, 2 * seed + number), gaze, seed).milliseconds["total"])
    # The first frames warm up.
    theirs, of_ours = (float(np.median(found[1:])) for found in times)
    return theirs / of_ours
