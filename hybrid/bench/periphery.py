"""What each acuity model saves in the periphery, and what that costs in quality."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.fovea.region import FoveaRegion, Foveation
from hybrid.frame.periphery import Periphery, Viewing
from hybrid.measure.metrics.fovvideovdp import jod
from hybrid.measure.metrics.ssim import ssim
from hybrid.measure.timing import percentiles
from splat.base.arrays import Arrays
from splat.lod.pictures import JoinedFrame
from splat.model.forest import Forest

GAZES = (Gaze(0.5, 0.5), Gaze(0.2, 0.2))
FULL = "none"
# Units of the scene per pass: far enough for another camera, near enough for the same picture.
_STEP = 1e-4


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
    """One row per gaze and acuity model; the acuity models' passes are interleaved with those of full level and full rate.

    A pass is everything from the gaze to the joined picture of what lies outside fov-b. What depends on the
    camera alone, the nodes' footprints and the map of attention, is kept while the camera stands still, as it
    does in `periphery_ms` and `full_ms`; in `moving_ms` and `moving_full_ms` every pass has another camera.
    Quality is that of the frame with only the periphery exchanged.
    """
    passes = _Passes(arrays, forest, display, fov_b)
    rows = []
    turns = range(-warm_up, repeats)
    for number, gaze in enumerate(GAZES):
        region = Foveation(gaze, fov_b, fov_b).region(camera.width, camera.height)
        kinds: list[dict[str, list[float]]] = []
        for moving in (True, False):
            times: dict[str, list[float]] = {acuity_model: [] for acuity_model in ACUITY_MODELS}
            for turn in turns:
                view = _moved(camera, turn * _STEP) if moving else camera
                frames = passes.run(view, gaze, region, times if turn >= 0 else None)
                done = (2 * number + len(kinds)) * len(turns) + turn + warm_up + 1
                progress(done, 2 * len(GAZES) * len(turns))
            kinds.append(times)
        full = frames[FULL].image().copy()
        fovea = region.weight_image()[..., None]
        for acuity_model in ACUITY_MODELS:
            image = frames[acuity_model].image() * (1 - fovea) + full * fovea
            row = {
                "acuity_model": acuity_model,
                "gaze": [gaze.x, gaze.y],
                "width": camera.width,
                "height": camera.height,
                "fov_b": fov_b,
                **_times(acuity_model, *kinds),
                "nodes_drawn": frames[acuity_model].nodes,
                "jod": jod(image, full, display, gaze),
                "ssim": ssim(image, full),
                "repeats": repeats,
                "layers": list(forest.counts),
            }
            rows.append(row)
    return rows


def _times(
    acuity_model: str, moving: dict[str, list[float]], still: dict[str, list[float]]
) -> dict[str, Any]:
    ratio = lambda times: float(np.median(times[FULL]) / np.median(times[acuity_model]))  # noqa: E731
    return {
        "periphery_ms": percentiles(still[acuity_model]),
        "full_ms": percentiles(still[FULL]),
        "ratio": ratio(still),
        "moving_ms": percentiles(moving[acuity_model]),
        "moving_full_ms": percentiles(moving[FULL]),
        "moving_ratio": ratio(moving),
    }


class _Passes:
    """The periphery once under each acuity model, one after the other."""

    def __init__(self, arrays: Arrays, forest: Forest, display: Display, fov_b: float):
        # One renderer each: none may live on what another one has just kept.
        self._renderers = {
            acuity_model: Periphery(arrays, forest, Viewing(display, acuity_model))
            for acuity_model in ACUITY_MODELS
        }
        self._fov_b = fov_b

    def run(
        self, camera: Camera, gaze: Gaze, region: FoveaRegion, times: dict[str, list[float]] | None
    ) -> dict[str, JoinedFrame]:
        frames = {}
        for acuity_model, renderer in self._renderers.items():
            start = time.perf_counter()
            frames[acuity_model] = renderer.draw(camera, renderer.detail(camera, gaze, self._fov_b), region)
            dr.sync_thread()
            if times is not None:
                times[acuity_model].append((time.perf_counter() - start) * 1000)
        return frames


def _moved(camera: Camera, distance: float) -> Camera:
    """A camera a little to the right."""
    pose = camera.world_to_camera.copy()
    pose[0, 3] -= distance
    return replace(camera, world_to_camera=pose)
