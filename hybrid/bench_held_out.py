"""What is lost where a forest takes the place of converged frames, on views that it was not trained on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from compose.acuity import LAWS
from compose.blend import Image
from compose.errors import UserError
from compose.foveation import Foveation
from compose.view import Camera, Display, Gaze
from hybrid.metrics.fovvideovdp import jod
from hybrid.metrics.similarity import quality
from hybrid.periphery import Periphery, Viewing
from pathtrace.frames import FrameSet, read_frame
from splat.arrays import Arrays
from splat.forest import Forest


def bench_held_out(
    arrays: Arrays,
    frames: FrameSet,
    forest: Forest,
    display: Display,
    fov_b: float,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per law: mean quality of held-out frames of which all outside of fov-b comes from the forest.

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
    renderers = {law: Periphery(arrays, forest, Viewing(display, law)) for law in LAWS}
    found: dict[str, list[dict[str, float | None]]] = {law: [] for law in LAWS}
    for number, entry in enumerate(frames.held_out):
        reference = read_frame(entry.file).radiance
        for law, renderer in renderers.items():
            image = _exchanged(renderer, entry.camera, reference, gaze, fov_b)
            found[law].append({"jod": jod(image, reference, display, gaze), **quality(image, reference)})
        progress(number + 1, len(frames.held_out))
    return [
        {
            "law": law,
            "views": len(rows),
            "fov_b": fov_b,
            "jod": _mean([row["jod"] for row in rows]),
            "lowest_jod": min((row["jod"] for row in rows if row["jod"] is not None), default=None),
            "psnr": _mean([row["psnr"] for row in rows]),
            "ssim": _mean([row["ssim"] for row in rows]),
        }
        for law, rows in found.items()
    ]


def _exchanged(renderer: Periphery, camera: Camera, reference: Image, gaze: Gaze, fov_b: float) -> Image:
    plan = Foveation(gaze, fov_b, fov_b).plan(camera.width, camera.height)
    fovea = plan.weight_image()[..., None]
    drawn = renderer.draw(camera, renderer.detail(camera, gaze, fov_b), plan).image()
    return drawn * (1 - fovea) + reference * fovea


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
