"""Adaptive sampling: how many more samples each pixel gets, given those it has and what they have shown.

Where the denoised samples and the splats agree, more samples change little; where they differ, one of the two
is wrong, and only samples can tell which.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.base.traced_samples import Counts
from compose.image.device_image import srgb_curve

if TYPE_CHECKING:
    from drjit.auto.ad import Float

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


def disagreement(arrays: Arrays, denoised: list[Float], splat: list[Float], shape: tuple[int, int]) -> Float:
    """Float (h * w,), worth of further samples: how much two images differ in sRGB, over 5 x 5 pixels.

    Both are three channels (h * w,) of linear radiance, at least one pixel. Where one of them is not a
    number, nothing is known, and they count as entirely different.
    """
    squares = [dr.square(_srgb(a) - _srgb(b)) for a, b in zip(denoised, splat, strict=True)]
    difference = dr.sum(squares) * (1 / 3)
    difference = dr.select(dr.isnan(difference), 1, difference)
    mean = window_sum(arrays, difference, shape, _WINDOW) * (1 / _WINDOW**2)
    return (dr.sqrt(mean) + _FLOOR) ** _POWER


def _srgb(radiance: Float) -> Float:
    """Linear radiance clipped to 0..1, on the sRGB curve; NaN stays."""
    lit = dr.select(radiance < 0, 0, radiance)
    return srgb_curve(dr.select(lit > 1, 1, lit))


def window_sum(arrays: Arrays, image: Float, shape: tuple[int, int], window: int) -> Float:
    """Float (h * w,), sums over square windows of so many pixels a side, the border repeated."""
    Int, UInt = arrays.plain.Int, arrays.plain.UInt
    width, height = (dr.opaque(Int, side) for side in shape[::-1])
    index = dr.arange(Int, shape[0] * shape[1])
    row = index // width
    column = index - row * width
    for axis in range(2):
        # Each pass looks up what the one before made of a pixel's neighbours.
        dr.eval(image)
        total = dr.zeros(arrays.plain.Float)
        for shift in range(-(window // 2), window // 2 + 1):
            i, j = (row, column + shift) if axis else (row + shift, column)
            at = dr.clip(i, 0, height - 1) * width + dr.clip(j, 0, width - 1)
            total += dr.gather(arrays.plain.Float, image, UInt(at))
        image = total
    return image


def allotted(arrays: Arrays, worth: Float, have: Float, total: int, seed: int) -> int | Counts:
    """Further samples of D pixels, `total` in all, that bring all pixels to what they are worth.

    Pixels that already have more get none; pixels that have none get at least one. Worth is samples (D,) that
    pixels should have, relative to each other; those whose worth is not finite get as many as any. The total
    is 0, or at least D. The seed is that of the rounding to the whole number below or above a pixel's due, by
    systematic sampling. One number is returned if all pixels get the same.
    """
    size, wide, UInt = dr.width(have), arrays.plain.Float64, arrays.plain.UInt
    if not total:
        return 0
    known = dr.isfinite(worth)
    counted, finite = dr.select(known, wide(1), 0), dr.select(known, wide(worth), 0)
    # Worth relative to its mean; that is 0 where nothing says which of the known pixels are worth more.
    mean = dr.sum(finite) / dr.maximum(dr.sum(counted), 1)
    share = dr.clip(finite / mean, _LEAST, _MOST)
    share = dr.select(mean > 0, share, 1)
    share = dr.select(known, share, _MOST)
    ends = dr.min(have), dr.max(have), dr.min(share), dr.max(share)
    dr.eval(share, ends)
    least_have, most_have, least_worth, most_worth = (float(end[0]) for end in ends)
    if least_have == most_have and least_worth == most_worth and total % size == 0:
        return total // size
    owned, most = wide(have), _MOST_AT_ONCE * total / size
    least = dr.select(owned < 1, wide(1), 0)
    low, high = dr.opaque(wide, 0.0), dr.opaque(wide, (most_have + most) / least_worth)
    # Opaque: what depends on the size of the disc would be compiled into kernels.
    limit, whole = dr.opaque(wide, most), dr.opaque(wide, total)
    # Samples (D,) that bring pixels to a level of what they are worth.
    due_at = lambda level: dr.clip(share * level - owned, least, limit)  # noqa: E731
    for _ in range(_HALVINGS):
        level = 0.5 * (low + high)
        few = dr.sum(due_at(level)) < whole
        low, high = dr.select(few, level, low), dr.select(few, high, level)
        dr.eval(low, high)
    due = due_at(0.5 * (low + high))
    start = dr.opaque(wide, np.random.default_rng(seed).random())
    end = dr.cumsum(due) * (whole / dr.sum(due))
    index = dr.arange(UInt, size)
    # Exactly the total, whatever the rounding of sums.
    end = dr.floor(dr.select(index == arrays.constant(size - 1), whole, end) + start)
    dr.eval(end)
    before = dr.gather(wide, end, index - 1, index > 0)
    # Sums of parts, whose rounding may let one fall below the one before it.
    each = UInt(dr.maximum(end - before, 0))
    dr.eval(each)
    return Counts(each, total, int(most) + 2)
