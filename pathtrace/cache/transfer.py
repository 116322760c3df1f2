"""What a cache keeps to follow lights that change: where to sample them, and how their light goes on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathtrace.cache.cells import Points
from pathtrace.cache.transport import Transport


@dataclass(frozen=True, eq=False)
class Rays:
    """M rays from points to surfaces that may show lights: mirrors, glossy surfaces and glass.

    Attributes:
        point: (M,) int32 index of the point that each starts at.
        square: (M, 2) where its direction lies, in 0..1, cosine-weighted around the normal.
        weight: (M,) of what it finds: the irradiance that arrives in this way for each unit of radiance.
    """

    point: NDArray[np.int32]
    square: NDArray[np.float32]
    weight: NDArray[np.float32]

    @staticmethod
    def none() -> Rays:
        """No rays."""
        nothing = np.zeros(0, dtype=np.float32)
        return Rays(nothing.astype(np.int32), np.zeros((0, 2), dtype=np.float32), nothing)

    def __len__(self) -> int:
        return len(self.point)


@dataclass(frozen=True, eq=False)
class Transfer:
    """Points in P patches and R regions, their direct light, and the transport of light from there.

    Attributes:
        points: N, in random order.
        patch: (N,) int32 patch of each.
        rays: from these points, in random order.
        direct: (P, 3) sums over each patch's points of the irradiance from lights.
        reflected: (R, 3) sums over each region's rays of the irradiance from lights seen in mirrors, glossy
            surfaces and glass.
        passed: (B, R) share of it that met at most 1, 2, ... such surfaces on its way; 1 in the last row.
        transport: of light between all C cells.
        known: (C,) mask of the cells that the cache answers from.
    """

    points: Points
    patch: NDArray[np.int32]
    rays: Rays
    direct: NDArray[np.float32]
    reflected: NDArray[np.float32]
    passed: NDArray[np.float32]
    transport: Transport
    known: NDArray[np.bool_]

    @staticmethod
    def none() -> Transfer:
        """That of a cache without cells."""
        dark, transport = np.zeros((0, 3), dtype=np.float32), Transport.none()
        nothing = np.zeros(0, dtype=np.int32), np.zeros(0, dtype=bool)
        passed = np.ones((1, 0), dtype=np.float32)
        return Transfer(Points.none(), nothing[0], Rays.none(), dark, dark, passed, transport, nothing[1])

    @property
    def bytes(self) -> int:
        """Memory that it takes."""
        arrays = (
            *(self.points.position, self.points.normal, self.patch),
            *(self.rays.point, self.rays.square, self.rays.weight),
            *(self.direct, self.reflected, self.passed, self.known),
        )
        return self.transport.bytes + sum(array.nbytes for array in arrays)

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
    def numbers(self) -> NDArray[np.int64]:
        """(P,) number of points in each patch."""
        return np.bincount(self.patch, minlength=len(self.transport.patches))

    @cached_property
    def ray_regions(self) -> NDArray[np.int64]:
        """(M,) region that each ray starts in."""
        return self.transport.patches.regions[self.patch[self.rays.point]]

    @cached_property
    def _shares(self) -> NDArray[np.float64]:
        """(P, 1) share of the points of its region that each patch has."""
        regions = self.transport.patches.regions
        shares: NDArray[np.float64] = (
            self.numbers / np.maximum(np.bincount(regions, self.numbers), 1)[regions]
        )
        return shares[:, None]

    @cached_property
    def _averaging(self) -> Any:
        return self.transport.patches.averaging(self.numbers)

    def of_cells(self, direct: NDArray[Any], reflected: NDArray[Any]) -> NDArray[np.float32]:
        """(B + 1, C, 3) irradiance of cells from lights, from sums like `direct` and `reflected`.

        The first is that of direct light, the next ones that of at most 1, 2, ... surfaces on the way.

        Lights seen in mirrors and through glass are found rarely, and are very bright then: no small cell has
        enough samples of them, so that each patch gets the mean of its region.
        """
        regions = self.transport.patches.regions
        shown = self._shares * reflected[regions]
        rows = [direct, *(direct + passed[regions, None] * shown for passed in self.passed)]
        return np.stack([self._averaging @ row.astype(np.float32) for row in rows])

    def irradiance(self, most: int) -> NDArray[np.float32]:
        """(K, C, 3) irradiance of cells, as of `IrradianceCache`; `most` as for `Transport.irradiance`."""
        return self.transport.irradiance(self.of_cells(self.direct, self.reflected), most)
