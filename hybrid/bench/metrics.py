"""Metrics of whole images, and their means."""

from __future__ import annotations

import numpy as np

from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from compose.image.colour import Image
from hybrid.measure.metrics.flip import flip
from hybrid.measure.metrics.fovvideovdp import jod
from hybrid.measure.metrics.similarity import quality


def image_metrics(image: Image, truth: Image) -> dict[str, float]:
    """PSNR, SSIM and, if installed, FLIP and FovVideoVDP's JOD of (H, W, 3) linear radiance.

    For FLIP and JOD, each pixel is one of a desktop monitor; for JOD, the gaze rests on the image's centre.

    Raises:
        UserError: the two images cannot be compared.
    """
    display = DISPLAYS["desktop"]
    optional = {
        "flip": flip(image, truth, display.pixels_per_degree),
        "jod": jod(image, truth, display, Gaze()),
    }
    return {**quality(image, truth), **{name: value for name, value in optional.items() if value is not None}}


def means(rows: list[dict[str, float]]) -> dict[str, float]:
    """Mean of each metric over the rows that have it."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: float(np.mean([row[name] for row in rows if name in row])) for name in names}
