"""Metrics of whole images, and their means."""

from __future__ import annotations

import numpy as np

from compose.image.colour import Image
from hybrid.measure.metrics.flip import flip
from hybrid.measure.metrics.similarity import quality


def image_metrics(image: Image, truth: Image) -> dict[str, float]:
    """PSNR, SSIM and, if installed, FLIP of (H, W, 3) linear radiance."""
    found = quality(image, truth)
    error = flip(image, truth)
    return found if error is None else {**found, "flip": error}


def means(rows: list[dict[str, float]]) -> dict[str, float]:
    """Mean of each metric over the rows that have it."""
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: float(np.mean([row[name] for row in rows if name in row])) for name in names}
