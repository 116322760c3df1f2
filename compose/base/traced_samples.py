"""What path tracer and composite both say about samples: how many there are, and of what.

A sample has a class of gloss, that is how much depends on the direction from which it is seen, and the number
of what it hits among what moves, by which poses say where that is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded

if TYPE_CHECKING:
    from drjit.auto.ad import Float, Float64, UInt

# Classes of gloss in ascending order: plain integers, for kernels of Dr.Jit and arrays of NumPy alike.
DIFFUSE, GLOSSY, SPECULAR = 0, 1, 2
# Numbers of movers, from 1 on; of what stands still; and of what deforms, or is seen in a mirror, so that
# nobody knows where it is at another time.
STILL, UNSTEADY = 0, (1 << 14) - 1


@dataclass(frozen=True)
class Counts:
    """Numbers of samples of D pixels: UInt (D,) of each, their total, and an upper bound of all."""

    each: dr.ArrayBase
    total: int
    most: int

    @staticmethod
    def of(each: dr.ArrayBase, most: int) -> Counts:
        """Waits for the sum."""
        return Counts(each, int(dr.sum(each)[0]), most)


@dataclass(frozen=True)
class Moment:
    """A time from 0 to 1, and where things are at it.

    Poses (K + 1, 3, 4), float64, lead from rest to that time, by the number of the mover; that of what stands
    still is the identity.
    """

    time: float
    poses: NDArray[np.float64]

    def at_rest(self, arrays: Arrays, position: list[Float], mover: Float) -> list[Float]:
        """Where points, three Floats (D,), of movers (D,) are at rest; others stay."""
        if len(self.poses) == 1:
            return position
        plain = arrays.plain
        moves = (mover != STILL) & (mover != UNSTEADY)
        row = arrays.packet(uploaded(plain.Float64, self.poses), 12, plain.UInt(mover), moves)
        shifted = [plain.Float64(at) - row[4 * i + 3] for i, at in enumerate(position)]
        # The inverse of a rotation is its transpose.
        rest = [sum(row[4 * i + j] * shifted[i] for i in range(3)) for j in range(3)]
        return [dr.select(moves, plain.Float(at), own) for at, own in zip(rest, position, strict=True)]

    def placed(self, arrays: Arrays, rest: list[Float], mover: UInt) -> list[Float] | list[Float64]:
        """Where points, three Floats (D,) at rest, of movers UInt (D,) are; in float64 if anything moves.

        What is unsteady stays where it was: its samples are of use until the next moment.
        """
        if len(self.poses) == 1:
            return rest
        table = uploaded(arrays.plain.Float64, self.poses)
        row = arrays.packet(table, 12, dr.select(mover < len(self.poses), mover, 0))
        point = [arrays.plain.Float64(at) for at in rest]
        return [sum(row[4 * i + j] * point[j] for j in range(3)) + row[4 * i + 3] for i in range(3)]


# Of a scene in which nothing moves.
ALWAYS = Moment(0.0, np.eye(4)[None, :3])
