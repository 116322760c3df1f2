"""Sample counts of positions whose mean need not be a whole number."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def fractional_counts(spp: float, positions: int, seed: int) -> int | NDArray[np.int64]:
    """Samples of each position, with mean `spp`: the whole numbers below and above it, shuffled.

    Args:
        spp: samples per position on average, at least 1.
        positions: N, the number of positions.
        seed: same seed, same counts.

    Returns:
        `spp` itself if it is a whole number, else (N,) counts; their sum is spp N, rounded.
    """
    whole = math.floor(spp)
    if spp == whole:
        return whole
    more = round((spp - whole) * positions)
    counts = np.full(positions, whole, dtype=np.int64)
    counts[np.random.default_rng(seed).permutation(positions)[:more]] += 1
    return counts
