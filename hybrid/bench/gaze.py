"""Whether anything pops while the gaze moves: how much the periphery changes from one step to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from compose.image.colour import srgb_from_radiance
from hybrid.frame.periphery import Periphery
from hybrid.frame.settings import FrameSettings
from hybrid.runtime.device import device_arrays
from splat.model.forest import Forest


def gazes_across(display: Display, fov_b: float, step: float, span: float) -> list[Gaze]:
    """Gazes from left to right through the centre of a frame that fills the display.

    Args:
        display: that the frame is shown on.
        fov_b: radius of the fovea in percent of the height.
        step, span: of the gaze, in degrees.

    Raises:
        UserError: two discs in a row cover the frame, so that there is nothing to compare.
    """
    angles = np.arange(round(span / step) + 1) * step - span / 2
    path = [Gaze(0.5 + float(np.tan(np.radians(a))) * display.focal / display.width, 0.5) for a in angles]
    if any(not np.any(a & b) for a, b in pairwise(_top_row(display, gaze, fov_b) for gaze in path)):
        raise UserError(f"--fov-b {fov_b}: covers the frame, nothing of the periphery is left to compare")
    return path


def _top_row(display: Display, gaze: Gaze, fov_b: float) -> NDArray[np.bool_]:
    """(W,) which pixels of the top row lie outside of the disc; where none does, none of the frame does."""
    region = Foveation(gaze, fov_b, fov_b).region(display.width, display.height)
    outside = np.ones(display.width, dtype=bool)
    outside[region.pixels[region.pixels < display.width]] = False
    return outside


def bench_gaze(
    forest: Forest,
    camera: Camera,
    settings: FrameSettings,
    path: list[Gaze],
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per acuity model: the gaze goes along a path while the camera stands still.

    Changes are those of the largest channel in sRGB, in 1/255, outside of fov-b in both frames.

    Args:
        forest, camera: what is drawn.
        settings: radii and display.
        path: of the gaze, from gazes_across with the same radius and display.
        progress: called with frames done and frames in total.
    """
    acuity_models = [acuity_model for acuity_model in ACUITY_MODELS if acuity_model != "none"]
    rows = []
    for number, acuity_model in enumerate(acuity_models):
        renderer = Periphery(device_arrays(), forest)
        before: tuple[NDArray[np.float32], NDArray[np.bool_]] | None = None
        tails, most = [], []
        for turn, gaze in enumerate(path):
            at_gaze = replace(settings, gaze=gaze, acuity_model=acuity_model)
            region = at_gaze.foveation.region(camera.width, camera.height)
            radiance = renderer.draw(camera, renderer.detail(camera, at_gaze), region).image()
            now = srgb_from_radiance(radiance) * np.float32(255), region.weight_image() == 0
            if before is not None:
                change = np.abs(now[0] - before[0]).max(axis=2)[now[1] & before[1]]
                tails.append(float(np.percentile(change, 99.9)))
                most.append(float(change.max()))
            before = now
            progress(number * len(path) + turn + 1, len(acuity_models) * len(path))
        rows.append(
            {
                "acuity_model": acuity_model,
                "width": camera.width,
                "height": camera.height,
                "change_p99_9": max(tails),
                "change_max": max(most),
                "median_change_p99_9": float(np.median(tails)),
                "layers": list(forest.counts),
            }
        )
    return rows
