"""Statistical tests of equal means over many pixels, with the Sidak correction, as Mitsuba's own tests do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

# Of one test that finds a difference where there is none. Seeds are fixed: a test fails always or never.
SIGNIFICANCE = 0.001


def blocks(images: NDArray, side: int = 4) -> NDArray[np.float64]:
    """(R, H / side, W / side, C) means over blocks of images (R, H, W, C).

    A pixel's samples are far from normally distributed; the mean of a block's is nearer to that.
    """
    runs, height, width, channels = images.shape
    cut = images[:, : height // side * side, : width // side * side].astype(np.float64)
    return cut.reshape(runs, height // side, side, width // side, side, channels).mean(axis=(2, 4))


def disagreement(one: NDArray, other: NDArray) -> float:
    """How surely two sets of runs (R, ...) and (S, ...) have different means somewhere: above 1, surely.

    Welch's t-test of each number and of the mean over all of them. The result is the logarithm of the least
    p-value over that of the threshold, which the Sidak correction lowers with the number of tests.
    """
    one, other = (np.asarray(runs, dtype=np.float64).reshape(len(runs), -1) for runs in (one, other))
    varies = (one.std(axis=0) > 1e-6 * np.abs(one.mean(axis=0))) | (
        other.std(axis=0) > 1e-6 * np.abs(other.mean(axis=0))
    )
    # What no sample ever changes must simply be equal.
    scale = np.abs(other).max() or 1.0
    if np.abs(one.mean(axis=0) - other.mean(axis=0))[~varies].max(initial=0) > 1e-5 * scale:
        return np.inf
    # A bias too small to show in any number shows in their mean.
    tests = [(one[:, varies], other[:, varies]), (one.mean(axis=1)[:, None], other.mean(axis=1)[:, None])]
    p = np.concatenate([stats.ttest_ind(a, b, equal_var=False).pvalue for a, b in tests])
    threshold = 1 - (1 - SIGNIFICANCE) ** (1 / len(p))
    return float(np.log(max(np.nanmin(p), 1e-300)) / np.log(threshold))
