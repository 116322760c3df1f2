"""What each law of the eye saves in the periphery, and what that costs in quality."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

from compose.acuity import LAWS
from compose.foveation import Foveation
from compose.view import Camera, Display, Gaze
from hybrid.fovvideovdp import jod
from hybrid.periphery import Periphery, Viewing
from hybrid.quality import ssim
from hybrid.timing import percentiles
from splat.arrays import Arrays
from splat.forest import Forest

GAZES = (Gaze(0.5, 0.5), Gaze(0.2, 0.2))
FULL = "none"


def display_camera(scene_camera: Camera, display: Display) -> Camera:
    """The scene's own view as the display opens it: its pose, under the angle that the display spans."""
    eye = display.viewer(display.width, display.height)
    return Camera(scene_camera.world_to_camera, *(getattr(eye, n) for n in _INTRINSICS))


_INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")


def bench_periphery(
    arrays: Arrays,
    forest: Forest,
    camera: Camera,
    display: Display,
    fov_b: float,
    repeats: int,
    warm_up: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per gaze and law; the laws' passes are interleaved with those of full level and full rate.

    A pass is everything from the gaze to the joined picture of what lies outside fov-b. The attention map is
    kept while the camera stands still, as it does here; what a moving camera pays for it stands in
    `saliency_ms`. Quality is that of the frame with only the periphery exchanged.
    """
    renderers = {law: Periphery(arrays, forest, Viewing(display, law)) for law in LAWS}
    saliency = _saliency_times(arrays, forest, camera, display, repeats)
    rows = []
    rounds = len(GAZES) * (repeats + warm_up)
    for number, gaze in enumerate(GAZES):
        plan = Foveation(gaze, fov_b, fov_b).plan(camera.width, camera.height)
        times: dict[str, list[float]] = {law: [] for law in LAWS}
        frames, nodes = {}, {}
        for turn in range(-warm_up, repeats):
            for law, renderer in renderers.items():
                start = time.perf_counter()
                drawn = renderer.draw(camera, renderer.detail(camera, gaze, fov_b), plan)
                dr.sync_thread()
                if turn >= 0:
                    times[law].append((time.perf_counter() - start) * 1000)
                frames[law], nodes[law] = drawn, drawn.nodes
            progress(number * (repeats + warm_up) + turn + warm_up + 1, rounds)
        full = frames[FULL].image().copy()
        fovea = plan.weight_image()[..., None]
        for law in LAWS:
            image = frames[law].image() * (1 - fovea) + full * fovea
            row = {
                "law": law,
                "gaze": [gaze.x, gaze.y],
                "width": camera.width,
                "height": camera.height,
                "fov_b": fov_b,
                "periphery_ms": percentiles(times[law]),
                "full_ms": percentiles(times[FULL]),
                "ratio": float(np.median(times[FULL]) / np.median(times[law])),
                "saliency_ms": 0.0 if law == FULL else saliency,
                "nodes_drawn": nodes[law],
                "jod": jod(image, full, display, gaze),
                "ssim": ssim(image, full),
                "repeats": repeats,
                "layers": list(forest.counts),
            }
            rows.append(row)
    return rows


def _saliency_times(arrays: Arrays, forest: Forest, camera: Camera, display: Display, repeats: int) -> float:
    """Median milliseconds of the attention map of a camera that was not seen before."""
    times = []
    for turn in range(-2, repeats):
        # A new renderer has no map to keep.
        fresh = Periphery(arrays, forest, Viewing(display))
        dr.sync_thread()
        start = time.perf_counter()
        fresh.saliency(camera)
        if turn >= 0:
            times.append((time.perf_counter() - start) * 1000)
    return float(np.median(times))
