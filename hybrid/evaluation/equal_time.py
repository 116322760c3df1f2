"""The number of rays at which a baseline takes as long as the hybrid frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compose.camera.view import View
from compose.eye.gaze import Gaze
from hybrid.evaluation.families import Family
from hybrid.measure.timing import jittered_view, path_around, ratio_interval, ratio_of_medians
from hybrid.methods.method import Method

# Costs count as equal within this share.
TOLERANCE = 0.03
# Trials at most.
_TRIALS = 12
# Frames of each method per trial, after one that is not measured: in steps of the first number, until the
# time is known well enough to decide, at most the second one.
_STEP, _MOST_FRAMES = 6, 60
# Between two frames' steps along the gaze path: few frames cover all of it as well.
_STRIDE = 23


@dataclass(frozen=True)
class Trial:
    """How long a baseline takes with that many rays per pixel, relative to the hybrid frame."""

    rays: float
    time: float


def at_equal_time(
    family: Family, ours: Method, views: Sequence[View], gaze: Gaze, rays: float
) -> float | None:
    """Rays per pixel at which a baseline comes closest to our time without exceeding it by over 3 %.

    Args:
        family: of the baseline; its time must grow with its rays.
        ours: the method whose time is to be met.
        views: through which frames go in turn.
        gaze: centre of the path that gazes follow.
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
            known[key] = relative_time(method, ours, views, gaze)
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
        if seed and seed % _STEP == 0 and _is_decided(*ratio_interval(times[0][1:], times[1][1:])):
            break
    return ratio_of_medians(times[0][1:], times[1][1:])


def _is_decided(low: float, high: float) -> bool:
    """Whether an interval of ratios tells if times are equal."""
    outside = low > 1 + TOLERANCE or high < 1 - TOLERANCE
    return outside or high - low <= TOLERANCE
