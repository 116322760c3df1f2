"""Timing of frames: methods interleaved along a fixed gaze path after a warm-up, and percentiles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.base.progress import Steps

# How far the gaze moves from the centre, in fractions of the frame's width and height.
REACH = (0.15, 0.15)
# And at least, in fractions of the frame's side.
_LEAST_REACH = 0.02
# Degrees from one frame's camera to the next one's, and the number of frames after which they repeat: at 50
# pixels per degree they differ by a twentieth of a pixel at most.
_NUDGE, _NUDGES = 1e-6, 1000
# Resamplings for an interval, and the probability of values outside it, on both sides together.
_RESAMPLINGS, _OUTSIDE = 1000, 0.05


def percentiles(milliseconds: list[float], wanted: Sequence[int] = (50, 95)) -> dict[str, float]:
    """Percentiles by name, such as p50; ValueError without times, or if one is negative or not finite."""
    if not milliseconds or not all(0 <= time < math.inf for time in milliseconds):
        raise ValueError(f"{len(milliseconds)} frames: there must be some, all of finite times")
    return {f"p{percent}": float(np.percentile(milliseconds, percent)) for percent in wanted}


def ratio_of_medians(over: Sequence[float], under: Sequence[float]) -> float:
    """Ratio of two medians; ValueError without times, or if a median is not positive and finite."""
    upper, lower = (float(np.median(times)) if len(times) else math.nan for times in (over, under))
    if not (0 < upper < math.inf and 0 < lower < math.inf):
        raise ValueError(f"medians of {upper} and {lower} ms: both must be positive and finite")
    return upper / lower


def medians_by_view(milliseconds: Sequence[float], views: int) -> list[float]:
    """Medians of each view, of frames that went through that many views in turn; of fewer frames, fewer."""
    return [float(np.median(milliseconds[first::views])) for first in range(min(views, len(milliseconds)))]


def ratio_interval(of_full: Sequence[float], ours: Sequence[float]) -> tuple[float, float]:
    """95 % confidence interval of the ratio of two medians, by a bootstrap over pairs rendered in turns."""
    pairs = np.array([of_full, ours])
    picks = np.random.default_rng(0).integers(pairs.shape[1], size=(_RESAMPLINGS, pairs.shape[1]))
    medians = np.median(pairs[:, picks], axis=2)
    low, high = np.quantile(medians[0] / medians[1], (_OUTSIDE / 2, 1 - _OUTSIDE / 2))
    return float(low), float(high)


def gaze_path(count: int, reach: tuple[float, float] = REACH) -> list[Gaze]:
    """Points on a closed curve around the centre, which reaches that far in fractions of width and height.

    With the default, a disc with a radius of up to 35 % of the height stays inside frames that are at least
    as wide as high.
    """
    turns = (2 * math.pi * i / count for i in range(count))
    return [Gaze(0.5 + reach[0] * math.sin(t), 0.5 + reach[1] * math.sin(2 * t + 0.5)) for t in turns]


def reach_for(radius: float, camera: Camera) -> tuple[float, float]:
    """How far the gaze may move from the centre so that a disc covers about as much as it does there.

    Along an axis on which the disc, of a radius in percent of the height, fits into the frame, that is until
    it touches the edge; along others so little that less than half a percent of the covered pixels is lost.
    The result is for `gaze_path`, in fractions of the frame's width and height.
    """
    pixels = radius / 100 * camera.height
    across, down = (
        max(_LEAST_REACH, min(most, 0.5 - pixels / side))
        for most, side in zip(REACH, (camera.width, camera.height), strict=True)
    )
    return across, down


def covered(radius: float, camera: Camera, count: int, reach: tuple[float, float]) -> float:
    """Mean fraction of the frame that a disc of a radius in percent of the height covers on a gaze path."""
    width, height = camera.width, camera.height
    along = (Foveation(gaze, radius, radius).region(width, height) for gaze in gaze_path(count, reach))
    return float(np.mean([region.count for region in along]) / (width * height))


def path_around(gaze: Gaze, count: int) -> list[Gaze]:
    """`gaze_path`, moved to a gaze and kept within the frame."""
    moved = ((at.x + gaze.x - 0.5, at.y + gaze.y - 0.5) for at in gaze_path(count))
    return [Gaze(min(max(x, 0.0), 1.0), min(max(y, 0.0), 1.0)) for x, y in moved]


def jittered_view(view: View, number: int) -> View:
    """The view, turned about the camera's vertical axis by too little to be visible.

    A frame that is timed with a camera of its own pays for everything, as every frame does while the viewer
    moves. A thousand consecutive numbers of frames give different keys, and none is the camera's own.
    """
    angle = math.radians(_NUDGE) * (1 + number % _NUDGES)
    turn = np.eye(4)
    turn[0, ::2] = math.cos(angle), math.sin(angle)
    turn[2, ::2] = -math.sin(angle), math.cos(angle)
    return replace(view, camera=replace(view.camera, world_to_camera=turn @ view.camera.world_to_camera))


def interleaved_passes(
    methods: Sequence[Callable[[Gaze, int], dict[str, float]]],
    repeats: int,
    warm_up: int,
    progress: Steps,
    reach: tuple[float, float],
) -> list[list[dict[str, float]]]:
    """Milliseconds per pass of each method at each step of the gaze path, on which all methods take turns.

    Methods are functions of gaze and seed that time their frame. Warm-up frames come before the `repeats`
    measured ones.
    """
    found: list[list[dict[str, float]]] = [[] for _ in methods]
    path = gaze_path(repeats, reach)
    for turn in range(-warm_up, repeats):
        for method, frames in zip(methods, found, strict=True):
            milliseconds = method(path[turn % repeats], turn + warm_up)
            if turn >= 0:
                frames.append(milliseconds)
        progress(turn + warm_up + 1, warm_up + repeats)
    return found
