"""What each pass of a frame costs, with a raw, a denoised and a fused fovea."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from compose.foveation import MODES, Foveation
from compose.view import Camera
from hybrid.renderer import HybridRenderer
from hybrid.timing import gaze_path, percentiles
from pathtrace.scene import Scene
from splat.forest import Forest


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
    renderers = {mode: HybridRenderer(scene, forest, mode=mode) for mode in MODES}
    found: dict[str, list[dict[str, float]]] = {mode: [] for mode in MODES}
    path = gaze_path(repeats)
    for turn in range(-warm_up, repeats):
        for mode, renderer in renderers.items():
            frame = renderer.frame(camera, Foveation(path[turn % repeats], *radii), spp, turn + warm_up)
            if turn >= 0:
                found[mode].append(frame.milliseconds)
        progress(turn + warm_up + 1, warm_up + repeats)
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
