"""Intel Open Image Denoise on a rectangle of radiance with its guides."""

from __future__ import annotations

import mitsuba_oidn
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]


def denoise(radiance: Image, albedo: Image, normal: Image, fast: bool = False) -> Image:
    """Removes Monte Carlo noise.

    Args:
        radiance: (H, W, 3) linear, unbounded; its pixels must be box-filtered and uncorrelated.
        albedo: (H, W, 3) in 0..1.
        normal: (H, W, 3), components in -1..1.
        fast: the quicker network, for frames shown in real time.

    Returns:
        (H, W, 3) denoised radiance.
    """
    quality = mitsuba_oidn.Quality.Fast if fast else mitsuba_oidn.Quality.High
    return np.asarray(
        mitsuba_oidn.denoise(
            np.ascontiguousarray(radiance, dtype=np.float32),
            np.clip(albedo, 0, 1).astype(np.float32),
            np.ascontiguousarray(normal, dtype=np.float32),
            hdr=True,
            quality=quality,
        )
    )
