"""The light of a scene at N points, from what rays found that start there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathtrace.cache.cells import Cells, Points
from pathtrace.cache.patches import Patches, sums_by
from pathtrace.cache.transfer import Rays, Transfer
from pathtrace.cache.transport import Transport
from pathtrace.fill.gather import Direct, Seen, gather_seen
from pathtrace.fill.guide import Guide
from pathtrace.fill.links import cells_hit, links_of


@dataclass(frozen=True, eq=False)
class Places:
    """N points, the cells and patches that they lie in, and the light of lights there."""

    points: Points
    cells: Cells
    patches: Patches
    patch: NDArray[np.int32]
    direct: Direct

    @staticmethod
    def of(points: Points, cells: Cells, direct: Direct) -> Places:
        patches, patch = Patches.of(cells.indices(points), len(cells))
        return Places(points, cells, patches, patch, direct)

    @cached_property
    def regions(self) -> NDArray[np.int64]:
        """(N,) region of each point."""
        return self.patches.regions[self.patch]

    def transfer(self, seen: Seen, hit: NDArray[np.int64], weight: NDArray[np.float32]) -> Transfer:
        """What rays from the points found, summed over patches, given the cells that they hit."""
        transport = Transport.of(links_of(seen, hit, weight), self.patches, self.patch)
        direct = sums_by(self.patch, self.direct.irradiance, len(self.patches))
        # Of each ray, the light that a point gets is pi times that, over the number of the point's rays.
        arriving = (np.pi * len(self.points) / len(seen.point) * weight).astype(np.float32)
        region = self.regions[seen.point]
        count = int(self.regions.max()) + 1
        shown = arriving[:, None] * seen.radiance
        reflected = sums_by(region, shown, count)
        shiny = np.flatnonzero(seen.shiny)
        rays = Rays(seen.point[shiny].astype(np.int32), seen.square[shiny], arriving[shiny])
        light = direct.astype(np.float32), reflected.astype(np.float32)
        passed = _passed(region, seen.passed, shown.mean(axis=1), count)
        return Transfer(self.points, self.patch, rays, *light, passed, transport, self.cells.known)


def _passed(
    region: NDArray[np.int64], passed: NDArray[np.int64], light: NDArray[np.float32], count: int
) -> NDArray[np.float32]:
    """(B, count) share of the light (M,) of each region's rays that met at most 1, 2, ... surfaces."""
    most = int(passed.max(initial=1))
    sums = np.bincount((passed - 1) * count + region, light, most * count).reshape(most, count).cumsum(axis=0)
    return np.divide(sums, sums[-1], out=np.ones_like(sums), where=sums[-1] > 0).astype(np.float32)


def guided_transfer(
    scene: Any, places: Places, even: Seen, most: int, random: np.random.Generator
) -> Transfer:
    """The transfer by rays in even directions, and by as many that follow where these found light.

    Args:
        scene: a Mitsuba scene.
        places: where the rays start.
        even: what was seen in even directions, by the same number of rays from each point.
        most: number of segments that count, as for `Transport.irradiance`.
        random: source of randomness.
    """
    points, cells = places.points, places.cells
    hit = cells_hit(even, points, cells)
    known = places.transfer(even, hit, np.ones(len(hit), dtype=np.float32)).irradiance(most)[-1]
    found = np.where(hit[:, None] >= 0, known[hit] * even.reflectance, 0) + np.pi * even.radiance
    brought, region = found.mean(axis=1), places.regions[even.point]
    guide = Guide.of(region, even.square, brought)
    further = gather_seen(
        scene, points, even.point, guide.squares(region, random), int(random.integers(1 << 32))
    )
    weights = guide.weights(region, even.square, brought), guide.weights(region, further.square)
    hits = hit, cells_hit(further, points, cells)
    return places.transfer(Seen.joined([even, further]), np.concatenate(hits), np.concatenate(weights))


def shuffled(transfer: Transfer, random: np.random.Generator) -> Transfer:
    """A transfer with its points and rays in random order, so that any part of them stands for all."""
    points, rays = (random.permutation(len(some)) for some in (transfer.points, transfer.rays))
    place = np.empty(len(points), dtype=np.int32)
    place[points] = np.arange(len(points), dtype=np.int32)
    moved = Rays(place[transfer.rays.point[rays]], transfer.rays.square[rays], transfer.rays.weight[rays])
    return replace(transfer, points=transfer.points.take(points), patch=transfer.patch[points], rays=moved)
