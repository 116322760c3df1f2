"""Whether details pop in or out while the gaze moves: how much the periphery changes from step to step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
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
    """Gazes from left to right through the centre of a frame as large as the display.

    Args:
        display: that the frame is shown on.
        fov_b: radius of the fovea in percent of the height.
        step: between two gazes, in degrees.
        span: from the first to the last one, in degrees.

    Raises:
        UserError: two consecutive discs cover the frame, so that there is nothing to compare.
    """
    angles = np.arange(round(span / step) + 1) * step - span / 2
    path = [Gaze(0.5 + float(np.tan(np.radians(a))) * display.focal / display.width, 0.5) for a in angles]
    if any(not np.any(a & b) for a, b in pairwise(_top_row(display, gaze, fov_b) for gaze in path)):
        raise UserError(f"fov-b {fov_b}: covers the frame, so that no periphery is left to compare")
    return path


def _top_row(display: Display, gaze: Gaze, fov_b: float) -> NDArray[np.bool_]:
    """(W,) pixels of the top row outside the disc; if there are none, the disc covers the frame."""
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
    """One row per acuity model: the gaze moves along a path while the camera stands still.

    A change is that of a pixel's largest channel in sRGB, in 1/255, between two consecutive frames; it counts
    outside fov-b of both.

    Args:
        forest, camera: what is drawn.
        settings: radii and display.
        path: of the gaze, from `gazes_across` with the same radius and display.
        progress: called with frames done and frames in total.

    Returns:
        Rows with the largest 99.9th percentile of all steps (change_p99_9), the largest change of all
        (change_max), and the median of the percentiles (median_change_p99_9).
    """
    models = [name for name in ACUITY_MODELS if name != "none"]
    rows = []
    for number, name in enumerate(models):
        before, total = number * len(path), len(models) * len(path)
        views = _views(forest, camera, replace(settings, acuity_model=name), path)
        changes = []
        for turn, (one, other) in enumerate(pairwise(views), 1):
            changes.append(_changes(one, other))
            progress(before + turn + 1, total)
        tails = [float(np.percentile(change, 99.9)) for change in changes]
        rows.append(
            {
                "acuity_model": name,
                "width": camera.width,
                "height": camera.height,
                "change_p99_9": max(tails),
                "change_max": max(float(change.max()) for change in changes),
                "median_change_p99_9": float(np.median(tails)),
                "layers": list(forest.counts),
            }
        )
    return rows


@dataclass(frozen=True)
class _View:
    """The periphery as seen with one gaze.

    Attributes:
        image: (H, W, 3) sRGB in 0..255.
        visible: (H, W) pixels outside fov-b.
    """

    image: NDArray[np.float32]
    visible: NDArray[np.bool_]


def _views(forest: Forest, camera: Camera, settings: FrameSettings, path: list[Gaze]) -> Iterator[_View]:
    """The periphery with each gaze of a path."""
    periphery = Periphery(device_arrays(), forest)
    for gaze in path:
        at_gaze = replace(settings, gaze=gaze)
        region = at_gaze.foveation.region(camera.width, camera.height)
        radiance = periphery.draw(camera, periphery.detail(camera, at_gaze), region).image()
        yield _View(srgb_from_radiance(radiance) * np.float32(255), region.weight_image() == 0)


def _changes(before: _View, now: _View) -> NDArray[np.float32]:
    """(N,) change of each pixel that is visible in both views."""
    return np.abs(now.image - before.image).max(axis=2)[now.visible & before.visible]
