"""Pixels that are out of all proportion: a path that found a lamp by chance, or broken splats.

Means and variances over windows, convolutions and denoising spread what one pixel shows over all around it.
Beside a pixel more than 2^24 times as bright as its neighbours float32 holds nothing of these, and its square
or the square of that may be too large for any float32. Such a pixel says nothing about its neighbourhood, so
it is kept out of what is computed for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import or_
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate, maximum_filter

from compose.image.colour import Image

# Radiance over that of its surroundings, or 1, from which a pixel is out of proportion: float32's precision.
MOST = 2.0**24
# All of the eight neighbours, and the pixel itself as well.
_BESIDE = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=bool)
_AROUND = np.ones((3, 3), dtype=bool)


def all_plain(channels: Sequence[Any]) -> bool:
    """Whether Dr.Jit floats, which this waits for, are finite, not negative and at most MOST, as usual."""
    wrong = [~((values >= 0) & (values <= MOST)) for values in channels]
    return not bool(dr.any(reduce(or_, wrong)))


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
