"""Lanes: which one traces which sample of which film position, and where in its pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from pathtrace.trace.film import FilmPositions

# Lanes are padded to a multiple of this with masked ones: a frozen function records again when the
# divisibility of its width changes, and masked lanes at the end cost next to nothing.
_LANE_MULTIPLE = 4096
# Logarithm of the number of places in a box before its sequence begins anew, shifted otherwise.
_PLACES = 12


@cache
def _sobol() -> NDArray[np.uint32]:
    """(2, 2 ** _PLACES) the binary digits of Sobol's points."""
    points = qmc.Sobol(2, scramble=False, bits=32).random_base2(_PLACES)
    return np.ascontiguousarray((points.T * 2.0**32).astype(np.uint32))


@dataclass(frozen=True)
class Lanes:
    """Which lane traces which sample of which position; the samples of a position lie side by side.

    Attributes:
        count: lanes in use; the others pad.
        active: which those are.
        index, step: position and number of the sample in it, of each lane.
        first: (N,) lane of each position's first sample.
        spp: samples per position.
    """

    count: int
    active: Any
    index: Any
    step: Any
    first: Any
    spp: int | NDArray[np.int64]

    @staticmethod
    def of(positions: int, spp: int | NDArray[np.int64]) -> Lanes:
        """Lanes for so many samples of each position."""
        count = positions * spp if isinstance(spp, int) else int(spp.sum())
        padded = -(-count // _LANE_MULTIPLE) * _LANE_MULTIPLE
        lane = dr.arange(mi.UInt32, padded)
        active = lane < dr.opaque(mi.UInt32, count)
        if isinstance(spp, int):
            index = lane // spp
            first = dr.arange(mi.UInt32, positions) * spp
            return Lanes(count, active, index, lane - index * spp, first, spp)
        first = mi.UInt32(np.cumsum(spp) - spp)
        index = mi.UInt32(np.pad(np.repeat(np.arange(positions), spp), (0, padded - count)))
        step = lane - dr.gather(mi.UInt32, first, index, active)
        return Lanes(count, active, index, step, first, spp)

    def places(self, positions: FilmPositions, taken: Any, pattern: Any) -> tuple[Any, Any]:
        """Film coordinates of each lane.

        Each box has a Sobol sequence of its own, its digits flipped at random (Kollig and Keller 2002):
        unbiased as independent places are, but edges and textures, and with them the auxiliary features, have far less
        noise, and later samples go where earlier ones left gaps.

        Args:
            positions: of all samples.
            taken: how many places of its sequence each position has used before; one for all, or (N,).
            pattern: another one, other shifts.
        """
        gathered = lambda values: dr.gather(type(values), values, self.index, self.active)  # noqa: E731
        corner = [gathered(positions.x), gathered(positions.y)]
        if dr.width(taken) > 1:
            taken = gathered(taken)
        bits = [dr.reinterpret_array(mi.UInt32, value) for value in corner]
        number = self.step + taken
        flips = mi.sample_tea_32(bits[0], bits[1] + pattern + (number >> _PLACES))
        number &= (1 << _PLACES) - 1
        unit = [
            mi.Float((dr.gather(mi.UInt32, digits, number) ^ flip) >> 8) * 2**-24
            for digits, flip in zip(map(mi.UInt32, _sobol()), flips, strict=True)
        ]
        sizes = (
            gathered(side) if dr.width(side) > 1 else side for side in (positions.width, positions.height)
        )
        x, y = (at + size * offset for at, size, offset in zip(corner, sizes, unit, strict=True))
        return x, y

    def added_up(self, channel: Any) -> Any:
        """(N,) sums over each position's samples."""
        channel = dr.gather(mi.Float, channel, dr.arange(mi.UInt32, self.count))
        if isinstance(self.spp, int):
            return channel if self.spp == 1 else dr.block_sum(channel, self.spp)
        # A pass may have no sample for a position.
        before = np.concatenate([[0.0], np.cumsum(channel.numpy(), dtype=np.float64)])
        first = self.first.numpy()
        return mi.Float(before[first + self.spp] - before[first])
