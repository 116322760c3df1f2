"""What the window can show of a frame, in sRGB."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance
from hybrid.frame.frame import Frame
from hybrid.interactive.request import Shows
from hybrid.pictures.levels import levels_picture

# A difference of so much in sRGB is shown as the strongest there is.
_STRONGEST = 0.25


def picture_of(shows: Shows, frame: Frame, path_traced: Image | None) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB.

    Args:
        shows: what.
        frame: the hybrid frame.
        path_traced: (H, W, 3) radiance of the whole frame, where that is in it.
    """
    if path_traced is not None:
        if shows == Shows.DIFFERENCE:
            return _heat(frame.composite, path_traced)
        if shows == Shows.SPLIT:
            return _split(frame.composite, path_traced)
        return _bytes(path_traced)
    if shows == Shows.FOVEA:
        return _bytes(frame.of_disc(frame.fovea.radiance * frame.region.weights[:, None]))
    if shows == Shows.PERIPHERY:
        return _bytes(frame.periphery)
    if shows == Shows.LEVELS:
        return levels_picture(frame.composite, frame.detail, frame.region)
    return _bytes(frame.composite)


def _bytes(radiance: Image) -> NDArray[np.uint8]:
    """`compose.blend.bytes_from_radiance` as a kernel: a tenth of the time, which counts here."""
    flat = mi.Float(np.ascontiguousarray(radiance).ravel())
    linear = dr.fmin(dr.fmax(flat, 0), 1)
    curve = dr.fma(1.055, dr.power(linear, 1 / 2.4), -0.055)
    value = dr.fma(dr.select(linear <= 0.0031308, 12.92 * linear, curve), 255, 0.5)
    return mi.UInt8(value).numpy().reshape(radiance.shape)


def _split(left: Image, right: Image) -> NDArray[np.uint8]:
    """One picture on the left of a white line, the other one on its right."""
    middle = left.shape[1] // 2
    picture = _bytes(np.concatenate([left[:, :middle], right[:, middle:]], axis=1))
    picture[:, middle] = 255
    return picture


def _heat(image: Image, reference: Image) -> NDArray[np.uint8]:
    """Black where they are equal, over red and yellow to white where they differ most."""
    difference = np.abs(srgb_from_radiance(image) - srgb_from_radiance(reference)).mean(axis=2)
    heat = 3 * np.clip(difference / _STRONGEST, 0, 1)[..., None] - np.arange(3)
    return (np.clip(heat, 0, 1) * 255 + 0.5).astype(np.uint8)
