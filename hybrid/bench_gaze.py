"""Whether anything pops while the gaze moves: how much the periphery changes from one step to the next."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.acuity import LAWS
from compose.blend import srgb_from_radiance
from compose.foveation import Foveation
from compose.view import Camera, Display, Gaze
from hybrid.periphery import Periphery, Viewing
from splat.arrays import Arrays
from splat.forest import Forest


def bench_gaze(
    arrays: Arrays,
    forest: Forest,
    camera: Camera,
    display: Display,
    fov_b: float,
    step: float,
    span: float,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per law: the gaze goes from left to right through the centre while the camera stands still.

    Changes are those of the largest channel in sRGB, in 1/255, outside of fov-b in both frames.

    Args:
        arrays, forest, camera, display: what is drawn, and for whom.
        fov_b: radius of the fovea in percent of the height.
        step, span: of the gaze, in degrees.
        progress: called with frames done and frames in all.
    """
    laws = [law for law in LAWS if law != "none"]
    angles = np.arange(round(span / step) + 1) * step - span / 2
    rows = []
    for number, law in enumerate(laws):
        renderer = Periphery(arrays, forest, Viewing(display, law))
        before: tuple[NDArray[np.float32], NDArray[np.bool_]] | None = None
        tails, most = [], []
        for turn, angle in enumerate(angles):
            gaze = Gaze(0.5 + float(np.tan(np.radians(angle))) * display.focal / camera.width, 0.5)
            plan = Foveation(gaze, fov_b, fov_b).plan(camera.width, camera.height)
            radiance = renderer.draw(camera, renderer.detail(camera, gaze, fov_b), plan).image()
            now = srgb_from_radiance(radiance) * np.float32(255), plan.weight_image() == 0
            if before is not None:
                change = np.abs(now[0] - before[0]).max(axis=2)[now[1] & before[1]]
                tails.append(float(np.percentile(change, 99.9)))
                most.append(float(change.max()))
            before = now
            progress(number * len(angles) + turn + 1, len(laws) * len(angles))
        rows.append(
            {
                "law": law,
                "width": camera.width,
                "height": camera.height,
                "step_degrees": step,
                "span_degrees": span,
                "change_p99_9": max(tails),
                "change_max": max(most),
                "median_change_p99_9": float(np.median(tails)),
                "layers": list(forest.counts),
            }
        )
    return rows
