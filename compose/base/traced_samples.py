"""What path tracer and composite say of samples alike: how many there are, and what they show.

Of what a sample shows: its class of gloss, that is how much depends on the direction it is seen from; and how
it moves, by numbers that samples have and the poses that go with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded


@dataclass(frozen=True)
class Counts:
    """Numbers of samples of D pixels.

    Attributes:
        each: UInt (D,), of each pixel.
        total: of all pixels.
        most: of any pixel, or more.
    """

    each: Any
    total: int
    most: int

    @staticmethod
    def of(each: Any, most: int) -> Counts:
        """The numbers (D,) of pixels; waits for their sum."""
        return Counts(each, int(dr.sum(each)[0]), most)


# Plain integers, in ascending order of gloss: kernels of Dr.Jit and arrays of numpy hold them alike.
DIFFUSE, GLOSSY, SPECULAR = 0, 1, 2


# Numbers that samples have: of what stands still; from 1 on, of what moves rigidly; and of what deforms, or
# is seen in a mirror, so that nobody knows where it is at another time.
STILL, UNSTEADY = 0, (1 << 14) - 1


@dataclass(frozen=True)
class Moment:
    """A time, and where things are at it.

    Attributes:
        time: from 0 to 1.
        poses: (K + 1, 3, 4) float64, from rest to that time, by the number that samples have; of what stands
            still, the identity.
    """

    time: float
    poses: NDArray[np.float64]

    def at_rest(self, arrays: Arrays, position: list[Any], mover: Any) -> list[Any]:
        """Where points, three Floats (D,), of movers Float (D,) are at rest.

        Those that stand still or are unsteady stay.
        """
        if len(self.poses) == 1:
            return position
        plain = arrays.plain
        moves = (mover != STILL) & (mover != UNSTEADY)
        row = dr.gather(
            plain.ArrayXf64, self.table(arrays), plain.UInt(mover), moves, shape=(12, dr.width(mover))
        )
        shifted = [plain.Float64(at) - row[4 * i + 3] for i, at in enumerate(position)]
        # The inverse of a rotation is its transpose.
        rest = [sum(row[4 * i + j] * shifted[i] for i in range(3)) for j in range(3)]
        return [dr.select(moves, plain.Float(at), own) for at, own in zip(rest, position, strict=True)]

    def table(self, arrays: Arrays) -> Any:
        """Flat Float64 of the poses."""
        return uploaded(arrays.plain.Float64, self.poses.reshape(-1, 12))


# Of a scene in which nothing moves.
ALWAYS = Moment(0.0, np.eye(4)[None, :3])
