"""Images of the window's views, in sRGB."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance
from hybrid.frame.frame import Frame
from hybrid.interactive.request import View
from hybrid.pictures.levels import levels_picture

# A difference of this much in sRGB has the strongest colour.
_STRONGEST = 0.25


def image_of(view: View, frame: Frame, path_traced: Image | None) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB image of a view.

    Args:
        view: what to show.
        frame: the hybrid frame.
        path_traced: (H, W, 3) radiance of the whole frame, for views that need it.
    """
    if path_traced is not None:
        if view == View.DIFFERENCE:
            return _heat(frame.composite, path_traced)
        if view == View.SPLIT:
            return _split(frame.composite, path_traced)
        return _bytes(path_traced)
    if view == View.FOVEA:
        return _bytes(frame.of_disc(frame.fovea.radiance * frame.region.weights[:, None]))
    if view == View.PERIPHERY:
        return _bytes(frame.periphery)
    if view == View.LEVELS:
        return levels_picture(frame.composite, frame.detail, frame.region)
    return _bytes(frame.composite)


def _bytes(radiance: Image) -> NDArray[np.uint8]:
    """compose.image.colour.bytes_from_radiance as a kernel, which takes a tenth of the time."""
    flat = mi.Float(np.ascontiguousarray(radiance).ravel())
    linear = dr.fmin(dr.fmax(flat, 0), 1)
    curve = dr.fma(1.055, dr.power(linear, 1 / 2.4), -0.055)
    value = dr.fma(dr.select(linear <= 0.0031308, 12.92 * linear, curve), 255, 0.5)
    return mi.UInt8(value).numpy().reshape(radiance.shape)


def _split(left: Image, right: Image) -> NDArray[np.uint8]:
    """Two images on either side of a white line."""
    middle = left.shape[1] // 2
    picture = _bytes(np.concatenate([left[:, :middle], right[:, middle:]], axis=1))
    picture[:, middle] = 255
    return picture


def _heat(image: Image, reference: Image) -> NDArray[np.uint8]:
    """Difference as a heat map: black for none, then red, yellow, and white for the strongest."""
    difference = np.abs(srgb_from_radiance(image) - srgb_from_radiance(reference)).mean(axis=2)
    heat = 3 * np.clip(difference / _STRONGEST, 0, 1)[..., None] - np.arange(3)
    return (np.clip(heat, 0, 1) * 255 + 0.5).astype(np.uint8)
