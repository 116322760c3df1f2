"""Continuous levels of detail against the layers of a forest, at as many Gaussians: what a viewer notices.

python -m benchmarks.levels SCENE --forest FOREST [--json FILE]
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

import hybrid
from benchmarks import measure_forest
from hybrid.base.compute_device import device_arrays
from hybrid.evaluation.splat_bench import display_camera
from hybrid.measure.image_metrics import psnr
from hybrid.measure.perceptual_metrics import jod
from hybrid.render.forest_attachments import own_views
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery
from splat.lod.layer_images import SplatImage
from splat.training.picture_fit import fitted_hierarchy

_STEPS, _REPEATS = 2000, 9
# Units of the scene that the camera moves per frame: enough to make it another one.
_STEP = 1e-4
# Nothing is path-traced.
_SPLATS = FrameSettings(fov_a=0.0, fov_b=0.0, fill=False)


def measured(scene_name: str, file: Path) -> dict[str, Any]:
    """Rows of methods on the display `desktop`, with the gaze in the middle, and what the fit brought."""
    forest, scene = hybrid.load_forest(file), hybrid.load_scene(scene_name)
    hierarchy, views = forest.own_hierarchy, own_views(forest)
    start = time.perf_counter()
    fitted, before, after = fitted_hierarchy(
        device_arrays(), hierarchy, forest.finest, forest.trained_focal, views, 0, _STEPS
    )
    seconds = time.perf_counter() - start
    camera = display_camera(scene.camera, _SPLATS.display)
    layers = Periphery(device_arrays(), forest)
    continuous = {
        name: Periphery(device_arrays(), replace(forest, hierarchy=own))
        for name, own in (("merged", hierarchy), ("fitted", fitted))
    }
    truth = layers.whole(camera, _SPLATS).numpy()

    def row(method: str, periphery: Periphery, settings: FrameSettings) -> dict[str, Any]:
        region = settings.foveation.region(camera.width, camera.height)

        def draw(number: int) -> SplatImage:
            view = camera.moved_right(number * _STEP)
            return periphery.draw(view, periphery.detail(view, settings, moving=True), region)

        times = []
        for number in range(-2, _REPEATS):
            start = time.perf_counter()
            draw(number)
            dr.sync_thread()
            times.append((time.perf_counter() - start) * 1000)
        drawn = draw(0)
        return {
            "method": method,
            "nodes": drawn.nodes,
            "ms": float(np.median(times[2:])),
            "psnr": psnr(drawn.numpy(), truth),
            "jod": jod(drawn.numpy(), truth, settings.display, settings.gaze),
        }

    rows = []
    for number in range(1, len(forest.counts)):
        rows.append(row(f"layer {number}", layers, replace(_SPLATS, layers=(number, number))))
        few = replace(_SPLATS, gaussians=rows[-1]["nodes"])
        rows += [row(f"{name}, as many", periphery, few) for name, periphery in continuous.items()]
    rows.append(row("layers, as the eye resolves", layers, _SPLATS))
    for level in (1.0, 2.0, 3.0):
        rows.append(row(f"fitted, level {level:g}", continuous["fitted"], replace(_SPLATS, level=level)))
    return {"rows": rows, "fit_seconds": seconds, "steps": _STEPS, "before_db": before, "after_db": after}


if __name__ == "__main__":
    measure_forest(__doc__, measured)
