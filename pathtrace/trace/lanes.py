"""Lanes: which thread of a kernel traces which sample of which film position."""

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

# Lanes are padded to a multiple of this with masked ones: a frozen function is recorded again when the
# divisibility of its width changes, and masked lanes at the end cost next to nothing.
_LANE_MULTIPLE = 4096
# After so many samples of a position its Sobol sequence restarts, scrambled otherwise.
_LOG2_SEQUENCE_LENGTH = 12


@cache
def _sobol_bits() -> NDArray[np.uint32]:
    """(2, 4096) coordinates of the Sobol points as 32-bit fixed-point fractions."""
    points = qmc.Sobol(2, scramble=False, bits=32).random_base2(_LOG2_SEQUENCE_LENGTH)
    return np.ascontiguousarray((points.T * 2.0**32).astype(np.uint32))


@dataclass(frozen=True)
class Lanes:
    """Assignment of lanes to samples; the samples of a position lie side by side.

    Attributes:
        count: lanes in use; the others are padding.
        active: mask of the lanes in use.
        index: film position of each lane.
        sample: number of each lane's sample among those of its position, from 0.
        first: (N,) lane of each position's first sample.
        spp: samples per position, one number for all or (N,) numpy integers.
    """

    count: int
    active: Any
    index: Any
    sample: Any
    first: Any
    spp: int | NDArray[np.int64]

    @staticmethod
    def of(positions: int, spp: int | NDArray[np.int64]) -> Lanes:
        """Lanes for `spp` samples of each of a number of positions."""
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
        sample = lane - dr.gather(mi.UInt32, first, index, active)
        return Lanes(count, active, index, sample, first, spp)

    def sample_positions(self, positions: FilmPositions, offset: Any, pattern: Any) -> tuple[Any, Any]:
        """Film coordinates (x, y) of each lane's sample.

        Each box has its own Sobol sequence, scrambled by a random digital shift (Kollig and Keller 2002).
        This is as unbiased as independent samples; but edges, textures and auxiliary features have far less
        noise, and later samples fill the gaps that earlier ones left.

        Args:
            positions: the boxes of all samples.
            offset: samples drawn from each position's sequence before, Dr.Jit integers: one for all, or (N,).
            pattern: Dr.Jit integer that selects the scrambling.
        """
        gathered = lambda values: dr.gather(type(values), values, self.index, self.active)  # noqa: E731
        corner = [gathered(positions.x), gathered(positions.y)]
        if dr.width(offset) > 1:
            offset = gathered(offset)
        corner_bits = [dr.reinterpret_array(mi.UInt32, value) for value in corner]
        number = self.sample + offset
        restarts = number >> _LOG2_SEQUENCE_LENGTH
        shifts = mi.sample_tea_32(corner_bits[0], corner_bits[1] + pattern + restarts)
        number &= (1 << _LOG2_SEQUENCE_LENGTH) - 1
        # 24 of the 32 bits: as many as a float in 0..1 holds without being rounded to 1.
        unit = [
            mi.Float((dr.gather(mi.UInt32, bits, number) ^ shift) >> 8) * 2**-24
            for bits, shift in zip(map(mi.UInt32, _sobol_bits()), shifts, strict=True)
        ]
        sizes = (
            gathered(side) if dr.width(side) > 1 else side for side in (positions.width, positions.height)
        )
        x, y = (start + size * share for start, size, share in zip(corner, sizes, unit, strict=True))
        return x, y

    def sums(self, channel: Any) -> Any:
        """(N,) sums of a channel, one value per lane, over each position's samples."""
        channel = dr.gather(mi.Float, channel, dr.arange(mi.UInt32, self.count))
        if isinstance(self.spp, int):
            return channel if self.spp == 1 else dr.block_sum(channel, self.spp)
        # Differences of a running sum also hold for positions without a sample in this pass.
        before = np.concatenate([[0.0], np.cumsum(channel.numpy(), dtype=np.float64)])
        first = self.first.numpy()
        return mi.Float(before[first + self.spp] - before[first])
