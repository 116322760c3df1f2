"""Images in linear radiance: their luminance, their conversion to sRGB, and what errors there are in dB."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch

# (H, W, 3) linear radiance, rows from the top.
Image = NDArray[np.float32]

# Luminance of linear red, green and blue (Rec. 709).
LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)
# The sRGB curve (IEC 61966-2-1): straight up to these linear and sRGB values, with this slope ...
SRGB_DARK, SRGB_DARK_VALUE, SRGB_SLOPE = 0.0031308, 0.04045, 12.92
# ... and a power beyond them (`srgb_power`).
SRGB_SCALE, SRGB_OFFSET, SRGB_GAMMA = 1.055, 0.055, 2.4
# Squared errors count as this at least: 120 dB.
LEAST_ERROR = 1e-12
_Numbers = TypeVar("_Numbers", float, NDArray[Any], "torch.Tensor")


def luminance(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """(...,) weighted sum of the colours of an image (..., 3), by the weights of Rec. 709."""
    return image @ np.array(LUMINANCE_WEIGHTS, dtype=np.float32)


def srgb_power(linear: _Numbers) -> _Numbers:
    """The bent part of the sRGB curve, at numbers of any kind."""
    return SRGB_SCALE * linear ** (1 / SRGB_GAMMA) - SRGB_OFFSET


def linear_power(srgb: _Numbers) -> _Numbers:
    """The inverse of `srgb_power`."""
    return ((srgb + SRGB_OFFSET) / SRGB_SCALE) ** SRGB_GAMMA


def srgb_from_radiance(radiance: Image) -> Image:
    """Linear radiance clipped to 0..1, on the sRGB curve."""
    clipped = np.clip(radiance, 0, 1)
    return np.where(clipped <= SRGB_DARK, SRGB_SLOPE * clipped, srgb_power(clipped)).astype(np.float32)


def srgb_slope(radiance: Image) -> Image:
    """By how much sRGB values change with radiance; 0 where they are clipped at 1."""
    curve = SRGB_SCALE / SRGB_GAMMA * np.power(np.maximum(radiance, SRGB_DARK), 1 / SRGB_GAMMA - 1)
    slope = np.where(radiance <= SRGB_DARK, SRGB_SLOPE, curve)
    return np.where(radiance < 1, slope, 0).astype(np.float32)


def radiance_from_srgb(srgb: NDArray[Any]) -> NDArray[Any]:
    """The inverse of `srgb_from_radiance`, of values from 0 to 1, in their precision."""
    return np.where(srgb <= SRGB_DARK_VALUE, srgb / SRGB_SLOPE, linear_power(srgb))


def bytes_from_radiance(radiance: Image) -> NDArray[np.uint8]:
    """Radiance as sRGB with eight bits per channel, as in a PNG file."""
    return (srgb_from_radiance(radiance) * 255 + 0.5).astype(np.uint8)


def decibels(squared_error: float) -> float:
    """PSNR in dB, at most 120, of a mean squared error of values in 0..1."""
    return float(-10 * np.log10(max(squared_error, LEAST_ERROR)))
