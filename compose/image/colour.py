"""Images in linear radiance: their luminance, and their conversion to sRGB."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# (H, W, 3) linear radiance, rows from the top.
Image = NDArray[np.float32]

# Luminance of linear red, green and blue (Rec. 709).
LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)


def luminance(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """(...,) weighted sum of the colours of an image (..., 3), by the weights of Rec. 709."""
    return image @ np.array(LUMINANCE_WEIGHTS, dtype=np.float32)


def srgb_from_radiance(radiance: Image) -> Image:
    """Linear radiance clipped to 0..1, on the sRGB curve (IEC 61966-2-1)."""
    clipped = np.clip(radiance, 0, 1)
    curve = 1.055 * np.power(clipped, 1 / 2.4) - 0.055
    return np.where(clipped <= 0.0031308, 12.92 * clipped, curve).astype(np.float32)


def radiance_from_srgb(srgb: Image) -> Image:
    """The inverse of `srgb_from_radiance`, of values from 0 to 1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, np.power((srgb + 0.055) / 1.055, 2.4)).astype(np.float32)


def bytes_from_radiance(radiance: Image) -> NDArray[np.uint8]:
    """Radiance as sRGB with eight bits per channel, as in a PNG file."""
    return (srgb_from_radiance(radiance) * 255 + 0.5).astype(np.uint8)
