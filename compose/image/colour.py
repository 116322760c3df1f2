"""Images in linear radiance, and their conversion to sRGB."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]


def srgb_from_radiance(radiance: Image) -> Image:
    """Linear radiance clipped to 0..1, on the sRGB curve (IEC 61966-2-1)."""
    clipped = np.clip(radiance, 0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * np.power(clipped, 1 / 2.4) - 0.055).astype(
        np.float32
    )


def bytes_from_radiance(radiance: Image) -> NDArray[np.uint8]:
    """Eight bits per channel, sRGB, as a PNG holds them."""
    return (srgb_from_radiance(radiance) * 255 + 0.5).astype(np.uint8)
