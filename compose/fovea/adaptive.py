"""Samples where they help: how many more each pixel gets, from those it has and what they have shown.

Where the denoised samples and the splats agree, more samples change little; where they differ, one of them is
wrong, and only samples can tell which.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from compose.image.colour import Image, srgb_from_radiance

# Least and most that a pixel should have, in means.
_LEAST, _MOST = 0.15, 5.0
# Most that it gets at once, in means.
_MOST_AT_ONCE = 8.0
# Of the interval that holds the level up to which samples are filled.
_HALVINGS = 25
# Difference that is there anyway.
_FLOOR = 0.005
_WINDOW = 5
# Of the difference: below 1, as the worst errors are few and need not all the samples.
_POWER = 0.8


def disagreement(denoised: Image, splat: Image) -> NDArray[np.float32]:
    """(H, W) what more samples are worth: the more two pictures differ in sRGB, over windows of 5 x 5."""
    difference = ((srgb_from_radiance(denoised) - srgb_from_radiance(splat)) ** 2).mean(axis=2)
    mean = np.maximum(uniform_filter(difference, _WINDOW, mode="nearest"), 0)
    return (np.sqrt(mean) + _FLOOR) ** _POWER


def allotted(
    worth: NDArray[np.float32], have: NDArray[np.float32], total: int, seed: int
) -> NDArray[np.int64]:
    """(D,) further samples per pixel, `total` in all, so that all pixels have what they are worth.

    None where there are more already, at least one where there are none at all.

    Args:
        worth: (D,) samples that pixels should have, relative to each other.
        have: (D,) samples that they have.
        total: at least D.
        seed: of the rounding: each gets the whole number below or above its due, by systematic sampling.
    """
    if (have == have[0]).all() and (worth == worth[0]).all() and total % len(have) == 0:
        return np.full(len(have), total // len(have), dtype=np.int64)
    worth = np.clip(worth / worth.mean(), _LEAST, _MOST)
    least, most = (have < 1).astype(np.float64), _MOST_AT_ONCE * total / len(have)
    low, high = 0.0, float((have.max() + most) / worth.min())
    for _ in range(_HALVINGS):
        level = 0.5 * (low + high)
        due = np.clip(worth * level - have, least, most)
        low, high = (level, high) if due.sum() < total else (low, level)
    ends = np.cumsum(due, dtype=np.float64) * (total / due.sum())
    start = np.random.default_rng(seed).random()
    return np.diff(np.floor(np.concatenate([[0.0], ends[:-1], [total]]) + start)).astype(np.int64)
