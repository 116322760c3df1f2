"""What is lost where a forest takes the place of converged frames, on views that it was not trained on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from compose.image.colour import Image
from hybrid.frame.periphery import Periphery, Viewing
from hybrid.measure.metrics.fovvideovdp import jod
from hybrid.measure.metrics.similarity import quality
from pathtrace.dataset.exr import read_frame
from pathtrace.dataset.frames import FrameSet
from splat.base.arrays import Arrays
from splat.model.forest import Forest


def bench_held_out(
    arrays: Arrays,
    frames: FrameSet,
    forest: Forest,
    display: Display,
    fov_b: float,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per acuity model: mean quality of held-out frames of which all outside of fov-b comes from the forest.

    Args:
        arrays, forest: what is drawn.
        frames: the converged ones.
        display: on which the viewer sees each of them, looking at its centre.
        fov_b: radius in percent of the height; inside of it the converged frame stays.
        progress: called with frames done and frames in all.

    Raises:
        UserError: no frame is held out.
    """
    if not frames.held_out:
        raise UserError(f"{frames.folder}: has no held-out frames")
    gaze = Gaze()
    renderers = {
        acuity_model: Periphery(arrays, forest, Viewing(display, acuity_model))
        for acuity_model in ACUITY_MODELS
    }
    found: dict[str, list[dict[str, float | None]]] = {acuity_model: [] for acuity_model in ACUITY_MODELS}
    for number, entry in enumerate(frames.held_out):
        reference = read_frame(entry.file).radiance
        for acuity_model, renderer in renderers.items():
            image = _exchanged(renderer, entry.camera, reference, gaze, fov_b)
            found[acuity_model].append(
                {"jod": jod(image, reference, display, gaze), **quality(image, reference)}
            )
        progress(number + 1, len(frames.held_out))
    return [
        {
            "acuity_model": acuity_model,
            "views": len(rows),
            "fov_b": fov_b,
            "jod": _mean([row["jod"] for row in rows]),
            "lowest_jod": min((row["jod"] for row in rows if row["jod"] is not None), default=None),
            "psnr": _mean([row["psnr"] for row in rows]),
            "ssim": _mean([row["ssim"] for row in rows]),
        }
        for acuity_model, rows in found.items()
    ]


def _exchanged(renderer: Periphery, camera: Camera, reference: Image, gaze: Gaze, fov_b: float) -> Image:
    region = Foveation(gaze, fov_b, fov_b).region(camera.width, camera.height)
    fovea = region.weight_image()[..., None]
    drawn = renderer.draw(camera, renderer.detail(camera, gaze, fov_b), region).image()
    return drawn * (1 - fovea) + reference * fovea


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
