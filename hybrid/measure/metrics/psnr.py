"""Peak signal-to-noise ratio."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance


def psnr(image: Image, reference: Image, where: NDArray[np.bool_] | None = None) -> float:
    """Peak signal-to-noise ratio in dB of linear (H, W, 3) radiance, sRGB clipped to 0..1.

    Args:
        image, reference: to compare.
        where: (H, W) pixels that count; all by default.
    """
    squares = (srgb_from_radiance(image) - srgb_from_radiance(reference)) ** 2
    error = np.mean(squares if where is None else squares[where], dtype=np.float64)
    return float(-10 * np.log10(max(error, 1e-12)))
