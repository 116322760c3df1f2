"""Samples where they help: how many more each pixel gets, from what the first ones have shown.

Where the denoised samples and the splats agree, more samples change little; where they differ, one of them is
wrong, and only samples can tell which.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from compose.blend import Image, srgb_from_radiance

# Least and most that a pixel gets, in means.
_LEAST, _MOST = 0.15, 5.0
# Difference that is there anyway.
_FLOOR = 0.005
_WINDOW = 5


def disagreement(denoised: Image, splat: Image) -> NDArray[np.float32]:
    """(H, W): root mean square over windows of 5 x 5 of what differs between two pictures, in sRGB."""
    difference = ((srgb_from_radiance(denoised) - srgb_from_radiance(splat)) ** 2).mean(axis=2)
    return np.sqrt(np.maximum(uniform_filter(difference, _WINDOW, mode="nearest"), 0)) + _FLOOR


def allotted(worth: NDArray[np.float32], total: int, seed: int) -> NDArray[np.int64]:
    """(D,) samples per pixel, `total` in all, in proportion to what they are worth (D,).

    By systematic sampling: each gets the whole number below or above its due.
    """
    due = worth / worth.mean()
    # Clipping changes the mean; a few rounds bring it back.
    for _ in range(4):
        due = np.clip(due, _LEAST, _MOST)
        due /= due.mean()
    ends = np.cumsum(due, dtype=np.float64) * (total / len(due))
    start = np.random.default_rng(seed).random()
    return np.diff(np.floor(np.concatenate([[0.0], ends[:-1], [total]]) + start)).astype(np.int64)
