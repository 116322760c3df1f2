"""What is lost if a forest replaces the periphery of converged frames, on held-out views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS
from compose.image.colour import Image
from hybrid.frame.periphery import Periphery
from hybrid.frame.settings import FrameSettings
from hybrid.measure.metrics.fovvideovdp import jod
from hybrid.measure.metrics.similarity import quality
from hybrid.runtime.device import device_arrays
from pathtrace.dataset.exr import read_frame
from pathtrace.dataset.frames import FrameSet
from splat.model.forest import Forest


def bench_held_out(
    frames: FrameSet,
    forest: Forest,
    settings: FrameSettings,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per acuity model: quality of held-out frames whose periphery is replaced.

    Args:
        frames: whose held-out frames are used, which are converged.
        forest: trained on the other ones.
        settings: gaze, display, and the disc inside of which the converged frame stays.
        progress: called with frames done and frames in total.

    Returns:
        Rows with means of jod (None if not installed), psnr and ssim, and lowest_jod.

    Raises:
        UserError: no frame is held out.
    """
    if not frames.held_out:
        raise UserError(f"{frames.folder}: has no held-out frames")
    periphery, display, gaze = Periphery(device_arrays(), forest), settings.display, settings.gaze
    models = {name: replace(settings, acuity_model=name) for name in ACUITY_MODELS}
    found: dict[str, list[dict[str, float | None]]] = {name: [] for name in ACUITY_MODELS}
    for number, entry in enumerate(frames.held_out):
        reference = read_frame(entry.file, entry.size).radiance
        for name, model in models.items():
            image = _replaced(periphery, model, entry.camera, reference)
            found[name].append({"jod": jod(image, reference, display, gaze), **quality(image, reference)})
        progress(number + 1, len(frames.held_out))
    return [
        {
            "acuity_model": acuity_model,
            "views": len(rows),
            "fov_b": settings.fov_b,
            "jod": _mean([row["jod"] for row in rows]),
            "lowest_jod": min((row["jod"] for row in rows if row["jod"] is not None), default=None),
            "psnr": _mean([row["psnr"] for row in rows]),
            "ssim": _mean([row["ssim"] for row in rows]),
        }
        for acuity_model, rows in found.items()
    ]


def _replaced(periphery: Periphery, settings: FrameSettings, camera: Camera, reference: Image) -> Image:
    """(H, W, 3) the reference with the periphery of the forest."""
    region = settings.foveation.region(camera.width, camera.height)
    fovea = region.weight_image()[..., None]
    drawn = periphery.draw(camera, periphery.detail(camera, settings), region).image()
    return drawn * (1 - fovea) + reference * fovea


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
