"""The window's views of a frame, in sRGB."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance
from compose.image.device import srgb_curve
from hybrid.frame.frame import Frame
from hybrid.interactive.converging import ConvergingFrame
from hybrid.interactive.request import View
from hybrid.pictures.levels import levels_picture

# Differences of this much in sRGB, or more, are white in the heat map.
_STRONGEST = 0.25


def image_of(view: View, frame: Frame, path_traced: ConvergingFrame | None) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB image of a view.

    Args:
        view: what to show.
        frame: the hybrid frame.
        path_traced: the whole frame, path-traced, for views that need it.

    Raises:
        ValueError: the view needs the path-traced frame, and there is none.
    """
    if view is View.LEVELS:
        return levels_picture(frame.composite, frame.detail, frame.region)
    if not view.needs_path_traced:
        return _of_frame(view, frame)
    if path_traced is None:
        raise ValueError(f"{view} needs the path-traced frame")
    if view is View.DIFFERENCE:
        return _heat_map(frame.composite, path_traced.denoised())
    if view is View.SPLIT:
        return _split(frame.composite, path_traced.image())
    return _srgb_bytes(path_traced.image())


def _of_frame(view: View, frame: Frame) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB image of a part of the frame, or of all of it."""
    if view is View.FOVEA:
        return _srgb_bytes(frame.of_disc([c * frame.fovea.disc.weights for c in frame.fovea.radiance]))
    shown = frame.splats if view is View.PERIPHERY else frame.image
    return _bytes_of(shown.tensor().array, (shown.height, shown.width, 3))


def _srgb_bytes(radiance: Image) -> NDArray[np.uint8]:
    """compose.image.colour.bytes_from_radiance as a kernel, which takes a tenth of the time."""
    return _bytes_of(mi.Float(np.ascontiguousarray(radiance).ravel()), radiance.shape)


def _bytes_of(flat: Any, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """sRGB bytes of linear radiance that is on the device: all that leaves it of a frame."""
    value = dr.fma(srgb_curve(dr.fmin(dr.fmax(flat, 0), 1)), 255, 0.5)
    return np.asarray(dr.uint8_array_t(type(value))(value)).reshape(shape)


def _split(left: Image, right: Image) -> NDArray[np.uint8]:
    """Two images on either side of a white line."""
    middle = left.shape[1] // 2
    image = _srgb_bytes(np.concatenate([left[:, :middle], right[:, middle:]], axis=1))
    image[:, middle] = 255
    return image


def _heat_map(image: Image, reference: Image) -> NDArray[np.uint8]:
    """Mean absolute difference in sRGB: black for none, then red, yellow, and white for the strongest."""
    difference = np.abs(srgb_from_radiance(image) - srgb_from_radiance(reference)).mean(axis=2)
    heat = 3 * np.clip(difference / _STRONGEST, 0, 1)[..., None] - np.arange(3)
    return (np.clip(heat, 0, 1) * 255 + 0.5).astype(np.uint8)
