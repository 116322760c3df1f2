"""The blend of periphery and fovea in linear radiance."""

from __future__ import annotations

from typing import Any

import drjit as dr

from compose.fovea.disc import Disc
from compose.image.device import DeviceImage


def blend(periphery: DeviceImage, fovea: list[Any], disc: Disc) -> DeviceImage:
    """(H, W, 3) composite: (1 - w) periphery + w fovea in the disc, the periphery elsewhere.

    Args:
        periphery: linear radiance of the frame.
        fovea: three Floats (D,), linear radiance of the disc's pixels.
        disc: which pixels those are, and their weights w.
    """
    arrays = periphery.arrays
    if disc.covers_frame:
        # Nothing of the periphery is left.
        return DeviceImage.filled(arrays, periphery.width, periphery.height, fovea)
    composite = periphery.packed()
    if disc.count:
        # Full weights copy instead of multiplying: 0 times a lamp's infinity is not 0.
        full = disc.weights >= 1
        behind = periphery.of_pixels(disc.pixels)
        mixed = [
            dr.select(full, front, back * (1 - disc.weights) + front * disc.weights)
            for front, back in zip(fovea, behind, strict=True)
        ]
        for channel, values in enumerate(mixed):
            dr.scatter(composite.values, values, disc.pixels * 3 + channel, mode=dr.ReduceMode.Permute)
        dr.eval(composite.values)
    return composite
