"""Light transport between cells: what each cell receives from lights, and of what the others reflect.

Radiosity (Goral et al. 1984) with form factors by Monte Carlo: each ray that was traced from a patch links it
to the cell that the ray hit. Light is then passed along the links without tracing anything, for any light
that falls on the cells directly. Cells of several levels overlap: what is known of a patch, which is what
lies in the same cells of all levels, serves all cells that it lies in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pathtrace.cache.cells import Floats, Indices, Mask, Points

# Numbers of segments whose light is told apart; more count as any number.
_MOST_STEPS = 8
# Bounces after which the light of an unbounded number of segments no longer changes visibly.
_UNBOUNDED = 32


@dataclass(frozen=True, eq=False)
class Patches:
    """P patches of C cells: (levels, P) indices of the cells in which each lies, ascending, or -1."""

    cells: NDArray[np.int32]
    count: int

    @staticmethod
    def of(cells: Indices, count: int) -> tuple[Patches, NDArray[np.int32]]:
        """The patches of points in cells (levels, N), -1 for none, and the (N,) index of each one's patch."""
        # Single numbers are sorted several times faster than columns.
        sizes = (count + 1,) * len(cells)
        names, patch = np.unique(np.ravel_multi_index(tuple(cells + 1), sizes), return_inverse=True)
        unique = np.stack(np.unravel_index(names, sizes)) - 1
        return Patches(unique.astype(np.int32), count), patch.astype(np.int32)

    def __len__(self) -> int:
        return self.cells.shape[1]

    @cached_property
    def regions(self) -> Indices:
        """(P,) number from 0 on that is the same for the patches of one largest cell."""
        _, region = np.unique(self.cells.max(axis=0, initial=-1), return_inverse=True)
        return region.astype(np.int64)

    def averaging(self, numbers: NDArray[Any]) -> sparse.csr_array:
        """(C, P) matrix that makes means over cells of sums over patches, of `numbers` (P,) samples."""
        level, patch = np.nonzero(self.cells >= 0)
        cell = self.cells[level, patch]
        samples = np.maximum(np.bincount(cell, numbers[patch], self.count), 1)
        shares = (1 / samples[cell]).astype(np.float32)
        return sparse.csr_array((shares, (cell, patch)), (self.count, len(self)))


def _bytes(*arrays: NDArray[Any]) -> int:
    return sum(array.nbytes for array in arrays)


def sums_by(place: NDArray[Any], values: NDArray[Any], count: int) -> NDArray[np.float64]:
    """(count, 3) sums of values (N, 3) over the places (N,) that they belong to."""
    return np.stack([np.bincount(place, channel, count) for channel in values.T], axis=1)


@dataclass(frozen=True)
class Links:
    """M rays from points, with the weight that each has in a mean."""

    point: Indices  # (M,) index of the point
    cell: Indices  # (M,) index of the cell that it hit, -1 outside the scene
    bounces: Indices  # (M,) mirrors and glass on the way
    # (M, 3) share of the irradiance of what was hit that arrives; 0 where a ray left the scene.
    reflectance: Floats


@dataclass(frozen=True, eq=False)
class Transport:
    """What C cells receive from each other, by way of P patches."""

    patches: Patches  # of the cells
    rays: NDArray[np.int32]  # (P,) number of rays from each patch
    # (B * P + 1,) where the links of each patch start; those of rays that met no mirror, glossy or glass
    # surface on the way, then those of rays that met one, and so on.
    starts: NDArray[np.int32]
    cells: NDArray[np.int32]  # (L,) cell that each link leads to
    reflectance: Floats  # (3, L) sum over the rays of each link, one row per colour channel

    @staticmethod
    def of(links: Links, patches: Patches, patch: NDArray[np.int32]) -> Transport:
        """The transport of links from N points, known or out of the scene, with the patch (N,) of each."""
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

    @property
    def bytes(self) -> int:
        """Memory that it takes."""
        return _bytes(self.patches.cells, self.rays, self.starts, self.cells, self.reflectance)

    @cached_property
    def _matrices(self) -> tuple[tuple[sparse.csr_array, ...], ...]:
        """For each number of surfaces on the way, three (P, C) matrices, one per colour channel."""
        shape = len(self.patches), self.patches.count
        matrices = []
        for first in range(0, len(self.starts) - 1, max(len(self.patches), 1)):
            rows = self.starts[first : first + len(self.patches) + 1]
            part = slice(rows[0], rows[-1])
            cells, ends = self.cells[part], rows - rows[0]
            channels = (sparse.csr_array((row[part], cells, ends), shape) for row in self.reflectance)
            matrices.append(tuple(channels))
        return tuple(matrices)

    @cached_property
    def _averaging(self) -> sparse.csr_array:
        return self.patches.averaging(self.rays)

    def received(self, known: Sequence[Floats]) -> Floats:
        """(C, 3) irradiance by way of other cells, whose own is known, of at most 1, 2, ... segments."""
        sums = np.zeros((len(self.patches), 3), dtype=np.float32)
        for channels, light in zip(self._matrices, reversed(known), strict=False):
            for channel, matrix in enumerate(channels):
                sums[:, channel] += matrix @ np.ascontiguousarray(light[:, channel])
        received: Floats = self._averaging @ sums
        return received

    def every(self, sent: Floats, most: int) -> list[Floats]:
        """Irradiance (C, 3) of at most 1, 2, ... segments from a light; `sent` and `most` as below."""
        known = [sent[0]]
        for segments in range(1, most if most > 0 else _UNBOUNDED):
            known.append(sent[min(segments, len(sent) - 1)] + self.received(known))
        return known

    def irradiance(self, sent: Floats, most: int) -> Floats:
        """(K, C, 3) irradiance by the number of segments from a light at most, as in `IrradianceCache`.

        What is sent (S, C, 3) comes from lights without other cells between; [n] is that of at most n + 1
        segments, the last that of all. There are `most` segments at most, 1 or more; below 0 for no bound.
        """
        return told_apart(self.every(sent, most))


def told_apart(known: Sequence[Floats]) -> Floats:
    """(K, C, 3) as in `IrradianceCache`, of irradiance (C, 3) of at most 1, 2, ... segments."""
    return np.stack([*known[: _MOST_STEPS - 1], known[-1]] if len(known) > _MOST_STEPS else known)


@dataclass(frozen=True, eq=False)
class Rays:
    """M rays from points to surfaces that may show lights: mirrors, glossy surfaces and glass."""

    point: NDArray[np.int32]  # (M,) index of the point
    square: Floats  # (M, 2) direction in 0..1, cosine-weighted around the normal
    weight: Floats  # (M,) irradiance that arrives in this way for each unit of radiance

    def __len__(self) -> int:
        return len(self.point)


@dataclass(frozen=True, eq=False)
class Transfer:
    """Points in P patches and R regions, their direct light, and the transport of light from there."""

    points: Points  # N, in random order
    patch: NDArray[np.int32]  # (N,) int32 patch of each
    rays: Rays  # from these points, in random order
    direct: Floats  # (P, 3) sums over each patch's points of the irradiance from lights
    # (R, 3) sums over each region's rays of the irradiance from lights seen in mirrors, glossy surfaces
    # and glass.
    reflected: Floats
    # (B, R) share of it that met at most 1, 2, ... such surfaces on its way; 1 in the last row.
    passed: Floats
    transport: Transport  # of light between all C cells
    known: Mask  # (C,) mask of the cells that the cache answers from

    @staticmethod
    def none() -> Transfer:
        """That of a cache without cells."""
        points, whole = Points.none(), np.zeros(0, dtype=np.int32)
        dark, numbers = points.position, np.zeros(0, dtype=np.float32)
        patches = Patches(np.zeros((1, 0), dtype=np.int32), 0)
        transport = Transport(patches, whole, np.zeros(1, dtype=np.int32), whole, dark.T)
        rays, passed = Rays(whole, dark[:, :2], numbers), np.ones((1, 0), dtype=np.float32)
        return Transfer(points, whole, rays, dark, dark, passed, transport, np.zeros(0, dtype=bool))

    @property
    def bytes(self) -> int:
        """Memory that it takes."""
        parts = *vars(self.points).values(), *vars(self.rays).values(), self.patch, self.direct
        return self.transport.bytes + _bytes(*parts, self.reflected, self.passed, self.known)

    def check(self) -> None:
        """Raises a ValueError if the sizes or indices of the parts do not match each other."""
        transport, patches = self.transport, self.transport.patches
        count, regions = len(patches), int(patches.regions.max(initial=-1)) + 1
        shapes = (
            (self.points.position, (len(self.patch), 3)),
            (self.points.normal, (len(self.patch), 3)),
            (self.rays.square, (len(self.rays), 2)),
            (self.rays.weight, (len(self.rays),)),
            (self.direct, (count, 3)),
            (self.reflected, (regions, 3)),
            (self.passed, (len(self.passed), regions)),
            (transport.rays, (count,)),
            (transport.reflectance, (3, len(transport.cells))),
        )
        indices = (
            (self.patch, count),
            (self.rays.point, len(self.patch)),
            (transport.cells, patches.count),
            (patches.cells + 1, patches.count + 1),
        )
        sizes = np.diff(transport.starts)
        whole = len(sizes) % max(count, 1) == 0 and transport.starts[-1] == len(transport.cells)
        if not (
            whole
            and len(self.passed)
            and (sizes >= 0).all()
            and all(array.shape == shape for array, shape in shapes)
            and all(((index >= 0) & (index < end)).all() for index, end in indices)
            and all(np.isfinite(array).all() for array, _ in shapes)
        ):
            raise ValueError("the parts of a transfer do not match")

    @cached_property
    def numbers(self) -> Indices:
        """(P,) number of points in each patch."""
        return np.bincount(self.patch, minlength=len(self.transport.patches))

    @cached_property
    def ray_regions(self) -> Indices:
        """(M,) region that each ray starts in."""
        return self.transport.patches.regions[self.patch[self.rays.point]]

    @cached_property
    def _averaging(self) -> sparse.csr_array:
        return self.transport.patches.averaging(self.numbers)

    def of_cells(self, direct: NDArray[Any], reflected: NDArray[Any]) -> Floats:
        """(B + 1, C, 3) irradiance of cells from lights, from sums like `direct` and `reflected`.

        The first is direct, the next ones met at most 1, 2, ... surfaces on the way. Lights in mirrors and
        behind glass are found rarely, and are very bright then, so that each patch gets the mean of its
        region.
        """
        regions = self.transport.patches.regions
        shares = self.numbers / np.maximum(np.bincount(regions, self.numbers), 1)[regions]
        shown = shares[:, None] * reflected[regions]
        rows = [direct, *(direct + passed[regions, None] * shown for passed in self.passed)]
        return np.stack([self._averaging @ row.astype(np.float32) for row in rows])

    def irradiance(self, most: int) -> Floats:
        """(K, C, 3) irradiance of cells, as in `IrradianceCache`; `most` as in `Transport.irradiance`."""
        return self.transport.irradiance(self.of_cells(self.direct, self.reflected), most)
