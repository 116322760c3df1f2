"""The blend of periphery and fovea in linear radiance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.fovea.rectangle import scatter
from compose.fovea.region import FoveaRegion
from compose.image.colour import Image


def blend(periphery: Image, fovea: NDArray[np.float32], region: FoveaRegion) -> Image:
    """(H, W, 3) composite: (1 - w) periphery + w fovea in the region, the periphery elsewhere.

    Args:
        periphery: (H, W, 3) linear radiance.
        fovea: (D, 3) linear radiance of the region's pixels.
        region: which pixels those are, and their weights w.
    """
    if region.covers_frame:
        # Blending would copy an image of which nothing is left.
        return np.array(fovea, dtype=np.float32).reshape(periphery.shape)
    composite = np.array(periphery, dtype=np.float32, order="C")
    flat = composite.reshape(-1, 3)  # (H * W, 3)
    # Full weights copy instead of multiplying: 0 times a lamp's infinity is not 0.
    band = np.flatnonzero(region.weights < 1)
    band_pixels, weight = region.pixels[band], region.weights[band, None]
    mixed = flat.take(band_pixels, axis=0) * (1 - weight) + fovea.take(band, axis=0) * weight
    scatter(flat, region.pixels, fovea)
    scatter(flat, band_pixels, mixed)
    return composite
