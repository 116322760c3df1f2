"""Adaptive sampling: how many more samples each pixel gets, from how many it has and what they have shown.

Where the denoised samples and the splats agree, more samples change little; where they differ, one of the two
is wrong, and only samples can tell which.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from compose.image.colour import Image, srgb_from_radiance

# Least and greatest worth of a pixel, relative to the mean.
_LEAST, _MOST = 0.15, 5.0
# Most samples that a pixel gets in one pass, relative to the mean of that pass.
_MOST_AT_ONCE = 8.0
# Bisections in the search for the level up to which samples are filled.
_HALVINGS = 25
# Difference in sRGB that is there even between correct images.
_FLOOR = 0.005
_WINDOW = 5  # pixels
# Exponent of the difference: below 1, since the worst errors are few and must not get all the samples.
_POWER = 0.8


def disagreement(denoised: Image, splat: Image) -> NDArray[np.float32]:
    """(H, W) worth of further samples: how much two images (H, W, 3) differ in sRGB, over 5 x 5 pixels.

    Where one of them is not a number, nothing is known, and they count as entirely different.
    """
    difference = ((srgb_from_radiance(denoised) - srgb_from_radiance(splat)) ** 2).mean(axis=2)
    # Here rather than in their mean: a running sum would carry it to the end of the row.
    difference = np.where(np.isnan(difference), np.float32(1), difference)
    mean = np.maximum(uniform_filter(difference, _WINDOW, mode="nearest"), 0)
    return (np.sqrt(mean) + _FLOOR) ** _POWER


def allotted(
    worth: NDArray[np.float32], have: NDArray[np.float32], total: int, seed: int
) -> NDArray[np.int64]:
    """(D,) further samples per pixel, `total` in all, that bring all pixels to what they are worth.

    Pixels that already have more get none; pixels that have none get at least one.

    Args:
        worth: (D,) samples that pixels should have, relative to each other; those whose worth is not finite
            get as many as any.
        have: (D,) samples that they have.
        total: 0, or at least D.
        seed: of the rounding to the whole number below or above a pixel's due, by systematic sampling.
    """
    if not total:
        return np.zeros(len(have), dtype=np.int64)
    worth = _relative(worth)
    if (have == have[0]).all() and (worth == worth[0]).all() and total % len(have) == 0:
        return np.full(len(have), total // len(have), dtype=np.int64)
    least, most = (have < 1).astype(np.float64), _MOST_AT_ONCE * total / len(have)
    low, high = 0.0, float((have.max() + most) / worth.min())
    for _ in range(_HALVINGS):
        level = 0.5 * (low + high)
        due = np.clip(worth * level - have, least, most)
        low, high = (level, high) if due.sum() < total else (low, level)
    ends = np.cumsum(due, dtype=np.float64) * (total / due.sum())
    start = np.random.default_rng(seed).random()
    return np.diff(np.floor(np.concatenate([[0.0], ends[:-1], [total]]) + start)).astype(np.int64)


def _relative(worth: NDArray[np.float32]) -> NDArray[np.float32]:
    """(D,) worth relative to its mean, within bounds; the most where it is not known."""
    with np.errstate(over="ignore", invalid="ignore"):
        mean = worth.mean()
    if np.isfinite(mean) and mean > 0:
        return np.clip(worth / mean, _LEAST, _MOST)
    known = np.isfinite(worth)
    wide = np.where(known, worth, 0).astype(np.float64)
    if not wide.any():
        # Nothing says which of the known pixels are worth more.
        return np.where(known, 1, _MOST).astype(np.float32)
    relative = np.clip(wide / (wide.sum() / known.sum()), _LEAST, _MOST)
    return np.where(known, relative, _MOST).astype(np.float32)
