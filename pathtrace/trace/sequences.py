"""Sobol sequences: each film position has one, whose points spread its samples evenly."""

from __future__ import annotations

import atexit
from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

# After so many points a sequence restarts, scrambled otherwise.
_LOG2_LENGTH = 12
# Pairs of dimensions: positions on the film, points on lights, directions of scattering.
FILM, LIGHT, SCATTERING = range(3)
_PAIRS = 3
# Keeps the scramblings of different pairs apart.
_PAIR_STEP = 0x9E3779B9
# Of the hash that scrambles each pair. Four leave a pattern where neighbouring positions differ in one word.
_ROUNDS = (4, 8, 8)


@cache
def _bits() -> NDArray[np.uint32]:
    """(2 * _PAIRS, 4096) coordinates of the Sobol points as 32-bit fixed-point fractions."""
    points = qmc.Sobol(2 * _PAIRS, scramble=False, bits=32).random_base2(_LOG2_LENGTH)
    return np.ascontiguousarray((points.T * 2.0**32).astype(np.uint32))


def sobol_tables() -> list[Any]:
    """The Sobol points as Dr.Jit arrays, one for each dimension."""
    return _tables(mi.variant())


@cache
def _tables(variant: str) -> list[Any]:
    """The Sobol points on the device of the variant that is set; uploaded once."""
    return [mi.UInt32(bits) for bits in _bits()]


# Dr.Jit complains of arrays that outlive it.
atexit.register(_tables.cache_clear)


@dataclass(frozen=True)
class Sequences:
    """The sequences of N lanes, scrambled by a random digital shift each (Kollig and Keller 2002).

    This is as unbiased as independent samples; but edges, textures, soft shadows and auxiliary features have
    far less noise, and later samples fill the gaps that earlier ones left.

    Attributes:
        tables: of `sobol_tables`.
        number: (N,) number of each lane's sample in its sequence.
        scramble: two (N,) Dr.Jit integers that select the scrambling.
    """

    tables: list[Any]
    number: Any
    scramble: tuple[Any, Any]

    def point(self, pair: int, number: Any) -> tuple[Any, Any]:
        """Coordinates in 0..1 of each sequence's point of a number (N,), in one pair of dimensions."""
        restarts = number >> _LOG2_LENGTH
        one, other = self.scramble
        shifts = mi.sample_tea_32(one, other + restarts + ((pair * _PAIR_STEP) & 0xFFFFFFFF), _ROUNDS[pair])
        index = number & ((1 << _LOG2_LENGTH) - 1)
        # 24 of the 32 bits: as many as a float in 0..1 holds without being rounded to 1.
        x, y = (
            mi.Float((dr.gather(mi.UInt32, table, index) ^ shift) >> 8) * 2**-24
            for table, shift in zip(self.tables[2 * pair : 2 * pair + 2], shifts, strict=True)
        )
        return x, y
