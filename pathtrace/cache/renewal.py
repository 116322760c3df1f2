"""Sums of light over places whose samples are taken anew, one part after the other.

Until a place has new samples, its old light stands for them, scaled by how the light of its region changed: a
lamp that is dimmed dims at once wherever it shines. When all samples were taken anew, nothing old is left.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pathtrace.cache.patches import sums_by

# Share of the mean light that a dark place is taken to have had: where it was dark, a lamp may now shine.
_LEAST = 1e-3
# New samples of a region that count as much as those of all regions.
_TRUST = 8
# Keeps the light of places that never had any above 0.
_DARK = 1e-12


class Renewal:
    """Sums over A places, before and after a change of the light.

    Args:
        sums: (A, 3) sums of the light of all samples of each place before the change.
        numbers: (A,) number of these samples.
        regions: (A,) number of the region that each place lies in, from 0 on.
    """

    def __init__(self, sums: NDArray[Any], numbers: NDArray[np.int64], regions: NDArray[np.int64]):
        self._numbers, self._regions = numbers, regions
        places = np.arange(len(numbers))
        shape = int(regions.max(initial=-1)) + 1, len(numbers)
        self._summing = sparse.csr_array((np.ones(len(numbers)), (regions, places)), shape)
        mean = sums.sum(axis=0) / max(numbers.sum(), 1)
        # Where nothing was lit, any new light is taken to be even.
        self._old = sums / np.maximum(numbers, 1)[:, None] + np.maximum(_LEAST * mean, _DARK)
        count = np.maximum(self._summing @ numbers, 1)
        self._trust = _TRUST * (self._summing @ (numbers[:, None] * self._old)) / count[:, None] + _DARK
        self._new = np.zeros_like(self._old)
        self._renewed = np.zeros(len(numbers))

    def add(self, places: NDArray[Any], light: NDArray[np.float32]) -> None:
        """Adds new samples: their places (M,), and their light (M, 3)."""
        self._new += sums_by(places, light, len(self._numbers))
        self._renewed += np.bincount(places, minlength=len(self._numbers))

    def sums(self) -> NDArray[np.float64]:
        """(A, 3) sums of the light of all samples of each place after the change."""
        found, expected = self._summing @ self._new, self._summing @ (self._renewed[:, None] * self._old)
        total = expected.sum(axis=0)
        overall = np.divide(found.sum(axis=0), total, out=np.ones(3), where=total > 0)
        change = (found + self._trust * overall) / (expected + self._trust)
        waiting = (self._numbers - self._renewed)[:, None]
        return self._new + waiting * self._old * change[self._regions]

    def again(self) -> Renewal:
        """The renewal after a further change."""
        return Renewal(self.sums(), self._numbers, self._regions)
