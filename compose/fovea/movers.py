"""What a sample shows, by how it moves: numbers that samples have, and the poses that go with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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

    def at_rest(self, position: NDArray[np.float32], mover: NDArray[np.uint16]) -> NDArray[np.float32]:
        """Where points (D, 3) of movers (D,) are at rest; those that stand still or are unsteady stay."""
        if len(self.poses) == 1:
            return position
        rest = position.copy()
        moving = np.flatnonzero((mover != STILL) & (mover != UNSTEADY))
        pose = self.poses[mover[moving]]
        shifted = position[moving].astype(np.float64) - pose[:, :, 3]
        # The inverse of a rotation is its transpose.
        rest[moving] = np.einsum("nji,nj->ni", pose[:, :, :3], shifted)
        return rest


# Of a scene in which nothing moves.
ALWAYS = Moment(0.0, np.eye(4)[None, :3])
