"""A hybrid frame against the full path-traced one and its disc alone, while the gaze moves."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode, Foveation
from hybrid.base.progress import Steps
from hybrid.evaluation.methods import FullTrace
from hybrid.measure.frame_times import (
    REACH,
    gaze_path,
    interleaved_passes,
    jittered_view,
    medians_by_view,
    percentiles,
    ratio_of_medians,
)
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings

# The gaze moves at least this far, in fractions of the frame's side.
_LEAST_REACH = 0.02


def reach_for(radius: float, camera: Camera) -> tuple[float, float]:
    """How far the gaze may move from the centre so that a disc covers about as much as it does there.

    Along an axis on which the disc, of a radius in percent of the height, fits into the frame, the gaze moves
    until the disc touches the edge. Along an axis on which it does not fit, moving loses more on one side
    than it gains on the other; there the gaze moves so little that less than half a percent of the covered
    pixels is lost. The result is for `gaze_path`, in fractions of the frame's width and height.
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


def _timed(method: Callable[[Gaze, int], Any], gaze: Gaze, seed: int) -> dict[str, float]:
    """Milliseconds until a method returns, which it does when its frame is complete."""
    start = time.perf_counter()
    method(gaze, seed)
    return {"total": (time.perf_counter() - start) * 1000}


def compare(
    renderer: Renderer,
    views: Sequence[View],
    settings: FrameSettings,
    repeats: int,
    warm_up: int,
    progress: Steps,
) -> dict[str, Any]:
    """One row: times of the hybrid frame, of the full path-traced frame, and of the disc alone.

    All three are timed after their kernels have been compiled; the full frame is traced by the same function
    as the disc, and denoised if the disc is. The gaze moves only so far that the disc stays in the frame.
    Frames go through the views, all of one size, in turn. Each has a camera of its own, so that it pays for
    all it shows.

    Returns:
        Percentiles hybrid_ms, path_traced_ms and disc_ms over all views, and the least and the greatest
        median of a view as hybrid_ms_range and so on; their ratios `ratio` (path-traced over hybrid), with
        `ratio_range`, and `ceiling` (path-traced over disc); the settings; and `covered`, the mean fraction
        of the frame that the disc covers.
    """
    full = FullTrace(
        renderer.tracer_of(settings.used_integrator), settings.spp, settings.fovea is not FoveaMode.RAW
    )
    camera = views[0].camera
    reach = reach_for(settings.fov_a, camera)

    def next_view(seed: int, place: int) -> View:
        """For the method in that place of the three."""
        return jittered_view(views[seed % len(views)], 3 * seed + place)

    def at(gaze: Gaze, seed: int, place: int) -> FrameSettings:
        view = next_view(seed, place)
        return replace(settings, gaze=gaze, camera=view.camera, time=view.time)

    methods: dict[str, Callable[[Gaze, int], Any]] = {
        "hybrid": lambda gaze, seed: renderer.frame(at(gaze, seed, 0), seed),
        "path_traced": lambda gaze, seed: full.render(next_view(seed, 1), gaze, seed),
        "disc": lambda gaze, seed: renderer.disc_alone(at(gaze, seed, 2), seed),
    }
    timed = [partial(_timed, method) for method in methods.values()]
    found = interleaved_passes(timed, repeats, warm_up, progress, reach)
    times = {name: [frame["total"] for frame in frames] for name, frames in zip(methods, found, strict=True)}
    by_view = {name: medians_by_view(values, len(views)) for name, values in times.items()}
    ratios = [full / ours for full, ours in zip(by_view["path_traced"], by_view["hybrid"], strict=True)]
    return {
        "width": camera.width,
        "height": camera.height,
        "spp": settings.spp,
        "fov_a": settings.fov_a,
        "fov_b": settings.fov_b,
        **{f"{name}_ms": percentiles(values) for name, values in times.items()},
        **{f"{name}_ms_range": (min(medians), max(medians)) for name, medians in by_view.items()},
        "ratio": ratio_of_medians(times["path_traced"], times["hybrid"]),
        "ratio_range": (min(ratios), max(ratios)),
        "ceiling": ratio_of_medians(times["path_traced"], times["disc"]),
        "covered": covered(settings.fov_a, camera, repeats, reach),
        "repeats": repeats,
    }
