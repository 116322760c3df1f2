"""Directions from which light comes, learnt from rays in even directions; further rays follow it.

Histograms over directions for places of a scene guide paths as in Jensen 1995; what both sets of rays bring
is combined by the balance heuristic (Veach and Guibas 1995).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

# Bins along each side of the square of directions.
_SIDE = 8
_BINS = _SIDE**2
# Share of the guided rays that is sent in even directions: nothing may be missed.
_EVEN = 0.5


@dataclass(frozen=True, eq=False)
class Guide:
    """Light by direction in R regions, found by M rays in even directions.

    A ray that brought much raises the density of its own direction, which would take weight from it: each
    ray is weighed by what the other rays found, or the sum would be too small.

    Attributes:
        light: (R, bins) sums of what the rays of each region brought.
    """

    light: NDArray[np.float64]

    @staticmethod
    def of(region: NDArray[np.int64], square: NDArray[np.float32], brought: NDArray[np.float32]) -> Guide:
        """The guide by what rays brought.

        Args:
            region: (M,) in which each ray starts, from 0 on.
            square: (M, 2) where its direction lies, in 0..1, cosine-weighted around the normal.
            brought: (M,) light, in any unit, at least 0.
        """
        regions = int(region.max(initial=-1)) + 1
        sums = np.bincount(region * _BINS + _bins(square), brought, regions * _BINS)
        return Guide(sums.reshape(regions, _BINS).astype(float))

    @cached_property
    def _total(self) -> NDArray[np.float64]:
        return self.light.sum(axis=1)

    def _density(self, light: NDArray[np.float64], total: NDArray[np.float64]) -> NDArray[np.float64]:
        """Density in the square where a bin has some of the light of its region; even where all is dark."""
        share = np.divide(light, total, out=np.full_like(light, 1 / _BINS), where=total > 0)
        return _EVEN + (1 - _EVEN) * _BINS * share

    def squares(self, region: NDArray[np.int64], random: np.random.Generator) -> NDArray[np.float32]:
        """Where the directions (M, 2) of guided rays lie.

        Args:
            region: (M,) in which each starts.
            random: source of randomness.
        """
        density = self._density(self.light, np.broadcast_to(self._total[:, None], self.light.shape))
        running = np.cumsum(density, axis=1)
        running /= running[:, -1:]
        # All rows in one ascending list: row r lies between r and r + 1.
        steps = (running + np.arange(len(running))[:, None]).ravel()
        chosen = np.searchsorted(steps, region + random.random(len(region)), side="right")
        bins = np.clip(chosen - region * _BINS, 0, _BINS - 1)
        corner = np.stack(np.divmod(bins, _SIDE), axis=1)
        square = ((corner + random.random(corner.shape)) / _SIDE).astype(np.float32)
        # Rounding must not reach the next bin.
        return np.minimum(square, np.nextafter(((corner + 1) / _SIDE).astype(np.float32), np.float32(0)))

    def weights(
        self,
        region: NDArray[np.int64],
        square: NDArray[np.float32],
        brought: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """(M,) weights of rays of a mean over as many even as guided ones.

        Args:
            region: (M,) in which each starts.
            square: (M, 2) where its direction lies.
            brought: (M,) what each brought, for those that the guide was learnt from.
        """
        own = np.zeros(len(region)) if brought is None else brought.astype(np.float64)
        light, total = self.light[region, _bins(square)] - own, self._total[region] - own
        # What rounding leaves of a sum of one ray is no light.
        rest = total > 1e-9 * self._total[region]
        density = self._density(np.where(rest, np.maximum(light, 0), 0), np.where(rest, total, 0))
        weights: NDArray[np.float32] = (2 / (1 + density)).astype(np.float32)
        return weights


def even_squares(count: int, each: int, random: np.random.Generator) -> NDArray[np.float32]:
    """(M, 2) even directions of `count` points in `each` strata, one ray of each point in every stratum."""
    square = random.random((count * each, 2), dtype=np.float32)
    square[:, 0] = (square[:, 0] + np.tile(np.arange(each, dtype=np.float32), count)) / each
    return np.minimum(square, np.nextafter(np.float32(1), np.float32(0)))


def _bins(square: NDArray[np.float32]) -> NDArray[np.int64]:
    """(M,) bin in which each point of the square lies."""
    row, column = np.minimum((square * _SIDE).astype(np.int64), _SIDE - 1).T
    return row * _SIDE + column
