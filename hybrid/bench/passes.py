"""Time of each pass of a frame, with a raw, a denoised and a fused fovea."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from compose.eye.gaze import Gaze
from compose.fovea.mode import FoveaMode
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from hybrid.measure.timing import interleaved_passes, percentiles
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest


def bench_passes(
    scene: Scene,
    forest: Forest,
    settings: FrameSettings,
    repeats: int,
    warm_up: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per fovea mode; the modes take turns along one gaze path.

    Args:
        scene, forest: what is rendered.
        settings: of the frames, apart from gaze and mode.
        repeats: measured frames per mode.
        warm_up: frames before that, which are not measured.
        progress: called with rounds done and rounds in total.

    Returns:
        Rows with percentiles of all `passes` in milliseconds; share_of_tracing, the median time of making the
        fovea from its samples over that of tracing them; and over_raw, by how much all of
        that exceeds the tracing of a raw fovea, as a fraction.
    """
    renderer = Renderer(scene, forest)
    camera = settings.camera or scene.camera

    def passes(mode: FoveaMode, gaze: Gaze, seed: int) -> dict[str, float]:
        return renderer.frame(replace(settings, gaze=gaze, fovea=mode), seed).milliseconds

    times = interleaved_passes([partial(passes, mode) for mode in FoveaMode], repeats, warm_up, progress)
    found = dict(zip(FoveaMode, times, strict=True))
    return [
        {
            "mode": mode.value,
            "width": camera.width,
            "height": camera.height,
            "spp": settings.spp,
            "fov_a": settings.fov_a,
            "fov_b": settings.fov_b,
            "passes": {name: percentiles([frame[name] for frame in frames]) for name in frames[0]},
            **_shares(found[FoveaMode.RAW], frames),
            "repeats": repeats,
        }
        for mode, frames in found.items()
    ]


def _shares(raw: list[dict[str, float]], frames: list[dict[str, float]]) -> dict[str, float]:
    """What is made of the samples, over the tracing of these frames, and over that of raw ones.

    Tracing includes albedo and normal, which raw frames do not need.
    """
    made = np.median([frame["fovea"] for frame in frames])
    tracing, bare = (np.median([frame["trace"] for frame in some]) for some in (frames, raw))
    return {"share_of_tracing": float(made / tracing), "over_raw": float((made + tracing) / bare - 1)}
