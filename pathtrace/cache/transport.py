"""Light transport between cells: what each cell receives of what the others reflect.

Radiosity (Goral et al. 1984) with form factors by Monte Carlo: each ray that was traced from a cell links it
to the cell that the ray hit. Light is then passed along the links without tracing anything, for any light
that falls on the cells directly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

# Numbers of segments whose light is told apart; more count as any number.
_MOST_STEPS = 8
# Bounces after which the light of an unbounded number of segments no longer changes visibly.
_UNBOUNDED = 32


@dataclass(frozen=True)
class Links:
    """M rays from points: what they hit, and what they brought.

    Attributes:
        point: (M,) index of the point that each ray started at.
        cell: (M,) cell that it hit; -1 where it left the scene.
        bounces: (M,) mirrors and glass surfaces on the way.
        reflectance: (M, 3) share of the irradiance of what was hit that arrives; 0 where it left the scene.
    """

    point: NDArray[np.int64]
    cell: NDArray[np.int64]
    bounces: NDArray[np.int64]
    reflectance: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Transport:
    """What C cells receive from each other.

    Attributes:
        matrices: for each number of mirrors and glass surfaces on the way, three (C, C) sparse matrices, one
            per colour channel.
    """

    matrices: tuple[tuple[sparse.csr_array, ...], ...]

    @staticmethod
    def of(links: Links, cells: NDArray[np.int64], count: int) -> Transport:
        """The transport of links.

        Args:
            links: rays whose hits are known, and rays that left the scene.
            cells: (levels, N) cells of each point, -1 for none.
            count: C, the number of cells.
        """
        rows = cells[:, links.point]  # (levels, M)
        rays = np.bincount(rows[rows >= 0], minlength=count)
        matrices = []
        for bounces in range(int(links.bounces.max(initial=0)) + 1):
            chosen = (rows >= 0) & (links.cell >= 0) & (links.bounces == bounces)
            level, ray = np.nonzero(chosen)
            row = rows[level, ray]
            places = row, links.cell[ray]
            share = links.reflectance[ray] / rays[row][:, None]
            matrices.append(tuple(sparse.csr_array((channel, places), (count, count)) for channel in share.T))
        return Transport(tuple(matrices))

    def irradiance(self, direct: NDArray[np.float32], most: int) -> NDArray[np.float32]:
        """Irradiance by the number of segments from a light at most.

        Args:
            direct: (C, 3) irradiance that comes from lights directly.
            most: number of segments at most, at least 1; below 0 for no bound.

        Returns:
            (K, C, 3) as of `IrradianceCache`.
        """
        last = most if most > 0 else _UNBOUNDED
        known = [direct]
        for segments in range(1, last):
            received = direct.copy()
            for bounces, channels in enumerate(self.matrices):
                if segments - 1 - bounces >= 0:
                    sent = known[segments - 1 - bounces]
                    for channel, matrix in enumerate(channels):
                        received[:, channel] += matrix @ sent[:, channel]
            known.append(received)
        return np.stack([*known[: _MOST_STEPS - 1], known[-1]] if last > _MOST_STEPS else known)
