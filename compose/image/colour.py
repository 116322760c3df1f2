"""Images in linear radiance: their luminance, conversion to sRGB, errors in dB, and pixels out of proportion.

Means and variances over windows, convolutions and denoising spread what one pixel shows over all around it.
Beside a pixel more than 2^24 times as bright as its neighbours float32 holds nothing of these, and its square
or the square of that may be too large for any float32. Such a pixel says nothing about its neighbourhood, so
it is kept out of what is computed for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate, maximum_filter

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
# Radiance over that of its surroundings, or 1, from which a pixel is out of proportion: float32's precision.
MOST = 2.0**24
# All of the eight neighbours, and the pixel itself as well.
_BESIDE = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=bool)
_AROUND = np.ones((3, 3), dtype=bool)
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


def outliers(image: Image, *others: Image, beside: bool = True) -> NDArray[np.bool_]:
    """(H, W, 1) pixels that are negative, not finite, or out of proportion to all that vouches for them.

    Other images of the same view (H, W, 3), in linear radiance, vouch for pixels and for those beside them;
    so do a pixel's eight neighbours if `beside`.
    """
    bright = _brightness(image)
    expected = np.zeros_like(bright)
    if beside:
        expected = maximum_filter(bright, footprint=_BESIDE, mode="constant")
    for other in others:
        expected = np.maximum(expected, maximum_filter(_brightness(other), footprint=_AROUND))
    wrong = (bright > MOST * np.maximum(expected.astype(np.float64), 1))[..., None]
    return wrong | ~np.isfinite(image).all(axis=2, keepdims=True) | (image < 0).any(axis=2, keepdims=True)


def filled(image: Image, wrong: NDArray[np.bool_]) -> Image:
    """The image (H, W, 3) with pixels (H, W, 1) replaced by the mean of their neighbours that are right.

    Those without such a neighbour are black.
    """
    right, known = np.where(wrong, 0, image).astype(np.float64), (~wrong).astype(np.float64)
    # Sums over 3 x 3 pixels.
    total, count = (correlate(of, _AROUND[..., None], mode="constant") for of in (right, known))
    return np.where(wrong, total / np.maximum(count, 1), image).astype(np.float32)


def _brightness(image: Image) -> NDArray[np.float32]:
    """(H, W) brightest channel; 0 where one is not finite."""
    return np.where(np.isfinite(image), image, 0).max(axis=2)
