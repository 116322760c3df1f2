"""The blend of two pictures in linear radiance, and the way to sRGB for files and screens."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.fovea.rectangle import scatter
from compose.fovea.region import FoveaRegion
from compose.image.colour import Image


def blend(periphery: Image, fovea: NDArray[np.float32], region: FoveaRegion) -> Image:
    """The composite: (1 - w) periphery + w fovea, touching only the disc's pixels.

    Args:
        periphery: (H, W, 3) linear radiance.
        fovea: (D, 3) linear radiance of the plan's pixels.
        plan: which pixels those are, and their weights.
    """
    if region.covers_frame:
        # The usual way would copy a picture that nothing is left of.
        return np.array(fovea, dtype=np.float32).reshape(periphery.shape)
    composite = np.array(periphery, dtype=np.float32, order="C")
    flat = composite.reshape(-1, 3)
    # Where only one picture counts it is taken as it is: 0 times a lamp's infinity is not 0.
    band = np.flatnonzero(region.weights < 1)
    shared, weight = region.pixels[band], region.weights[band, None]
    mixed = flat.take(shared, axis=0) * (1 - weight) + fovea.take(band, axis=0) * weight
    scatter(flat, region.pixels, fovea)
    scatter(flat, shared, mixed)
    return composite
