"""The blend of two pictures in linear radiance, and the way to sRGB for files and screens."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.foveation import FoveaPlan
from compose.rectangle import lay

Image = NDArray[np.float32]


def blend(periphery: Image, fovea: NDArray[np.float32], plan: FoveaPlan) -> Image:
    """The composite: (1 - w) periphery + w fovea, touching only the disc's pixels.

    Args:
        periphery: (H, W, 3) linear radiance.
        fovea: (D, 3) linear radiance of the plan's pixels.
        plan: which pixels those are, and their weights.
    """
    if plan.covers_frame:
        # The usual way would copy a picture that nothing is left of.
        return np.array(fovea, dtype=np.float32).reshape(periphery.shape)
    composite = np.array(periphery, dtype=np.float32, order="C")
    flat = composite.reshape(-1, 3)
    # Where only one picture counts it is taken as it is: 0 times a lamp's infinity is not 0.
    band = np.flatnonzero(plan.weights < 1)
    shared, weight = plan.pixels[band], plan.weights[band, None]
    mixed = flat.take(shared, axis=0) * (1 - weight) + fovea.take(band, axis=0) * weight
    lay(flat, plan.pixels, fovea)
    lay(flat, shared, mixed)
    return composite


def srgb_from_radiance(radiance: Image) -> Image:
    """Linear radiance clipped to 0..1, on the sRGB curve (IEC 61966-2-1)."""
    clipped = np.clip(radiance, 0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * np.power(clipped, 1 / 2.4) - 0.055).astype(
        np.float32
    )


def bytes_from_radiance(radiance: Image) -> NDArray[np.uint8]:
    """Eight bits per channel, sRGB, as a PNG holds them."""
    return (srgb_from_radiance(radiance) * 255 + 0.5).astype(np.uint8)
