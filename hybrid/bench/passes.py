"""What each pass of a frame costs, with a raw, a denoised and a fused fovea."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.mode import MODES
from compose.fovea.region import Foveation
from hybrid.frame.renderer import HybridRenderer
from hybrid.measure.timing import interleaved_passes, percentiles
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest


def bench_passes(
    scene: Scene,
    forest: Forest,
    camera: Camera,
    radii: tuple[float, float],
    spp: int,
    repeats: int,
    warm_up: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per mode of the fovea, `passes` in milliseconds; the modes take turns along one gaze path.

    Args:
        scene, forest: what is rendered.
        camera: the view.
        radii: fov-a and fov-b.
        spp: samples per pixel in the disc.
        repeats: measured frames per mode.
        warm_up: frames before that.
        progress: called with rounds done and rounds in all.
    """
    renderers = [HybridRenderer(scene, forest, mode=mode) for mode in MODES]

    def passes(renderer: HybridRenderer, gaze: Gaze, seed: int) -> dict[str, float]:
        return renderer.frame(camera, Foveation(gaze, *radii), spp, seed).milliseconds

    methods = [partial(passes, renderer) for renderer in renderers]
    times = interleaved_passes(methods, repeats, warm_up, progress)
    found = dict(zip(MODES, times, strict=True))
    return [
        {
            "mode": mode,
            "width": camera.width,
            "height": camera.height,
            "spp": spp,
            "fov_a": radii[0],
            "fov_b": radii[1],
            "passes": {name: percentiles([frame[name] for frame in frames]) for name in frames[0]},
            **_shares(found["raw"], frames),
            "repeats": repeats,
        }
        for mode, frames in found.items()
    ]


def _shares(raw: list[dict[str, float]], frames: list[dict[str, float]]) -> dict[str, float]:
    """What is made of the samples, over the tracing of these frames, and over that of raw ones.

    Tracing finds albedo and normal as well where they are used; raw frames need neither.
    """
    made = np.median([frame["fovea"] + frame["under"] for frame in frames])
    tracing, bare = (np.median([frame["trace"] for frame in some]) for some in (frames, raw))
    return {"share_of_tracing": float(made / tracing), "over_raw": float((made + tracing) / bare - 1)}
