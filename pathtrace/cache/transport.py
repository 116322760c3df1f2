"""Light transport between cells: what each cell receives of what the others reflect.

Radiosity (Goral et al. 1984) with form factors by Monte Carlo: each ray that was traced from a patch links it
to the cell that the ray hit. Light is then passed along the links without tracing anything, for any light
that falls on the cells directly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pathtrace.cache.patches import Patches, sums_by

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
    """What C cells receive from each other, by way of P patches.

    Attributes:
        patches: of the cells.
        rays: (P,) number of rays from each patch.
        starts: (B * P + 1,) where the links of each patch start; those of rays that met no mirror, glossy or
            glass surface on the way, then those of rays that met one, and so on.
        cells: (L,) cell that each link leads to.
        reflectance: (3, L) sum over the rays of each link, one row per colour channel.
    """

    patches: Patches
    rays: NDArray[np.int32]
    starts: NDArray[np.int32]
    cells: NDArray[np.int32]
    reflectance: NDArray[np.float32]

    @staticmethod
    def of(links: Links, patches: Patches, patch: NDArray[np.int32]) -> Transport:
        """The transport of links.

        Args:
            links: rays whose hits are known, and rays that left the scene.
            patches: of the points.
            patch: (N,) that each point lies in.
        """
        start = patch[links.point]
        rays = np.bincount(start, minlength=len(patches)).astype(np.int32)
        hit = links.cell >= 0
        row = links.bounces[hit] * len(patches) + start[hit]
        names = row * patches.count + links.cell[hit]
        linked, link = np.unique(names, return_inverse=True)
        sums = sums_by(link, links.reflectance[hit], len(linked))
        rows = len(patches) * (int(links.bounces.max(initial=0)) + 1)
        starts = np.searchsorted(linked, np.arange(rows + 1) * patches.count).astype(np.int32)
        cells = (linked % patches.count).astype(np.int32)
        return Transport(patches, rays, starts, cells, np.ascontiguousarray(sums.T, dtype=np.float32))

    @staticmethod
    def none() -> Transport:
        """The transport between no cells."""
        nothing = np.zeros(0, dtype=np.int32)
        patches = Patches(np.zeros((1, 0), dtype=np.int32), 0)
        no_links = np.zeros((3, 0), dtype=np.float32)
        return Transport(patches, nothing, np.zeros(1, dtype=np.int32), nothing, no_links)

    @property
    def bytes(self) -> int:
        """Memory that it takes."""
        arrays = self.patches.cells, self.rays, self.starts, self.cells, self.reflectance
        return sum(array.nbytes for array in arrays)

    @cached_property
    def _matrices(self) -> tuple[tuple[sparse.csr_array, ...], ...]:
        """For each number of surfaces on the way, three (P, C) matrices, one per colour channel."""
        shape = len(self.patches), self.patches.count
        matrices = []
        for first in range(0, len(self.starts) - 1, max(len(self.patches), 1)):
            rows = self.starts[first : first + len(self.patches) + 1]
            part = slice(rows[0], rows[-1])
            places = self.cells[part], rows - rows[0]
            matrices.append(
                tuple(sparse.csr_array((channel[part], *places), shape) for channel in self.reflectance)
            )
        return tuple(matrices)

    @cached_property
    def _averaging(self) -> sparse.csr_array:
        return self.patches.averaging(self.rays)

    def received(self, known: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """(C, 3) irradiance that comes from lights by way of other cells.

        Args:
            known: irradiance (C, 3) of at most 1, 2, ... segments.
        """
        sums = np.zeros((len(self.patches), 3), dtype=np.float32)
        for channels, light in zip(self._matrices, reversed(known), strict=False):
            for channel, matrix in enumerate(channels):
                sums[:, channel] += matrix @ np.ascontiguousarray(light[:, channel])
        received: NDArray[np.float32] = self._averaging @ sums
        return received

    def every(self, sent: NDArray[np.float32], most: int) -> list[NDArray[np.float32]]:
        """Irradiance (C, 3) of at most 1, 2, ... segments from a light; `sent` and `most` as below."""
        known = [sent[0]]
        for segments in range(1, most if most > 0 else _UNBOUNDED):
            known.append(sent[min(segments, len(sent) - 1)] + self.received(known))
        return known

    def irradiance(self, sent: NDArray[np.float32], most: int) -> NDArray[np.float32]:
        """Irradiance by the number of segments from a light at most.

        Args:
            sent: (S, C, 3) irradiance that comes from lights without other cells between; [n] is that of at
                most n + 1 segments, the last that of all.
            most: number of segments at most, at least 1; below 0 for no bound.

        Returns:
            (K, C, 3) as of `IrradianceCache`.
        """
        return told_apart(self.every(sent, most))


def told_apart(known: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """(K, C, 3) as of `IrradianceCache`, of irradiance (C, 3) of at most 1, 2, ... segments."""
    return np.stack([*known[: _MOST_STEPS - 1], known[-1]] if len(known) > _MOST_STEPS else known)
