"""Fills a cache of irradiance: where paths from some views end, the light of the scene is sampled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from compose.camera.camera import Camera
from pathtrace.cache.cells import SIDES, Cells, Floats, Grid, Indices, Mask, Points, joined_points
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.cache.light_selection import LightChoice
from pathtrace.cache.transport import Links, Patches, Rays, Transfer, Transport, sums_by
from pathtrace.fill.gather import Seen, gather_direct, gather_seen
from pathtrace.scene.instances import AnyScene
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import opaque_camera, random_numbers, ray_through
from pathtrace.trace.first_hit import first_hits

# Bins along each side of the square of directions.
_SIDE = 8
_BINS = _SIDE**2
# Share of the guided rays that is sent in even directions: nothing may be missed.
_EVEN = 0.5
# Points that are looked at to find a near one, at most.
_CANDIDATES = 1 << 16
# Distance, in units of the cells' scale, that counts as much as an angle of 60 degrees between normals.
_TURNED = 0.1


class Guide:
    """Light (R, bins) by direction in R regions: sums of what M rays in even directions brought.

    It is in any unit, at least 0; directions lie at squares as in `Seen`. A ray that brought much raises the
    density of its own direction, which would take weight from it: each ray is weighed by what the others
    found.
    """

    def __init__(self, region: Indices, square: Floats, brought: Floats):
        regions = int(region.max(initial=-1)) + 1
        sums = np.bincount(region * _BINS + _bins(square), brought, regions * _BINS)
        self._light = sums.reshape(regions, _BINS).astype(float)
        self._total = self._light.sum(axis=1)

    def _density(self, light: NDArray[np.float64], total: NDArray[np.float64]) -> NDArray[np.float64]:
        """Density in the square where a bin has some of the light of its region; even where all is dark."""
        share = np.divide(light, total, out=np.full_like(light, 1 / _BINS), where=total > 0)
        return _EVEN + (1 - _EVEN) * _BINS * share

    def squares(self, region: Indices, random: np.random.Generator) -> Floats:
        """Where the directions (M, 2) of guided rays lie, which start in regions (M,)."""
        density = self._density(self._light, np.broadcast_to(self._total[:, None], self._light.shape))
        running = np.cumsum(density, axis=1)
        running /= running[:, -1:]
        # All rows in one ascending list: row r lies between r and r + 1.
        steps = (running + np.arange(len(running))[:, None]).ravel()
        chosen = np.searchsorted(steps, region + random.random(len(region)), side="right")
        bins = np.clip(chosen - region * _BINS, 0, _BINS - 1)
        corner = np.stack(np.divmod(bins, _SIDE), axis=1)
        square = ((corner + random.random(corner.shape)) / _SIDE).astype(np.float32)
        # Rounding must not reach the next bin.
        return np.minimum(square, np.nextafter(((corner + 1) / _SIDE).astype(np.float32), np.float32(0)))

    def weights(self, region: Indices, square: Floats, brought: Floats | None = None) -> Floats:
        """(M,) weights of rays in a mean over even and guided ones; of even ones with what they `brought`."""
        own = np.zeros(len(region)) if brought is None else brought.astype(np.float64)
        light, total = self._light[region, _bins(square)] - own, self._total[region] - own
        # What rounding leaves of a sum of one ray is no light.
        rest = total > 1e-9 * self._total[region]
        density = self._density(np.where(rest, np.maximum(light, 0), 0), np.where(rest, total, 0))
        weights: Floats = (2 / (1 + density)).astype(np.float32)
        return weights


def even_squares(count: int, each: int, random: np.random.Generator) -> Floats:
    """(M, 2) even directions of `count` points in `each` strata, one ray of each point in every stratum."""
    square = random.random((count * each, 2), dtype=np.float32)
    square[:, 0] = (square[:, 0] + np.tile(np.arange(each, dtype=np.float32), count)) / each
    return np.minimum(square, np.nextafter(np.float32(1), np.float32(0)))


def _bins(square: Floats) -> Indices:
    row, column = np.minimum((square * _SIDE).astype(np.int64), _SIDE - 1).T
    return row * _SIDE + column


def cells_hit(seen: Seen, points: Points, cells: Cells) -> Indices:
    """(M,) cell that each ray hit; -1 where it left the scene, or if there is no cell.

    Where a ray hit no known cell, that of the nearest point that faces the same way stands for it: these rays
    often hit what is darker than the mean of the others, such as corners.
    """
    hit = np.where(seen.valid, cells.smallest(seen.hits), -1)
    lost = np.flatnonzero(seen.valid & (hit < 0))
    if not len(lost):
        return hit
    candidates = points.take(np.arange(0, len(points), -(-len(points) // _CANDIDATES)))
    own = cells.smallest(candidates)
    if (own < 0).all():
        return hit
    scale = np.float32(cells.grid.scale)
    place = lambda some: np.hstack([some.position / scale, np.float32(_TURNED) * some.normal])  # noqa: E731
    tree = KDTree(place(candidates.take(own >= 0)), balanced_tree=False, compact_nodes=False)
    _, nearest = tree.query(place(seen.hits.take(lost)))
    hit[lost] = own[own >= 0][nearest]
    return hit


def links_of(seen: Seen, cell: Indices, weight: Floats) -> Links:
    """The links of rays, by the cells (M,) that they hit and their weights (M,) in the means of points."""
    # Without any cell, nothing can be said of the rays that hit something.
    kept = np.flatnonzero(~seen.valid | (cell >= 0))
    reflectance = weight[kept, None] * seen.reflectance[kept]
    return Links(seen.point[kept], cell[kept], seen.bounces[kept], reflectance)


class GuidedPlaces:
    """N points, the cells and regions (N,) that they lie in, and irradiance (N, 3) from lights there."""

    def __init__(self, points: Points, cells: Cells, direct: Floats):
        self.points, self.cells, self.direct = points, cells, direct
        self._patches, self._patch = Patches.of(cells.indices(points), len(cells))
        self.regions = self._patches.regions[self._patch]

    def transfer(self, seen: Seen, hit: Indices, weight: Floats) -> Transfer:
        """What rays from the points found, summed over patches, given the cells that they hit."""
        transport = Transport.of(links_of(seen, hit, weight), self._patches, self._patch)
        direct = sums_by(self._patch, self.direct, len(self._patches))
        # Of each ray, the light that a point gets is pi times that, over the number of the point's rays.
        arriving = (np.pi * len(self.points) / len(seen.point) * weight).astype(np.float32)
        region = self.regions[seen.point]
        count = int(self.regions.max()) + 1
        shown = arriving[:, None] * seen.radiance
        reflected = sums_by(region, shown, count)
        shiny = np.flatnonzero(seen.shiny)
        rays = Rays(seen.point[shiny].astype(np.int32), seen.square[shiny], arriving[shiny])
        light = direct.astype(np.float32), reflected.astype(np.float32)
        # Shares of the light of each region's rays that met at most 1, 2, ... surfaces.
        most = int(seen.passed.max(initial=1))
        met = np.bincount((seen.passed - 1) * count + region, shown.mean(axis=1), most * count)
        met = met.reshape(most, count).cumsum(axis=0)
        passed = np.divide(met, met[-1], out=np.ones_like(met), where=met[-1] > 0).astype(np.float32)
        return Transfer(self.points, self._patch, rays, *light, passed, transport, self.cells.known)


def guided_transfer(
    scene: AnyScene, places: GuidedPlaces, even: Seen, most: int, random: np.random.Generator
) -> Transfer:
    """The transfer by even rays, as many of each point, and by as many that follow what these found."""
    points, cells = places.points, places.cells
    hit = cells_hit(even, points, cells)
    known = places.transfer(even, hit, np.ones(len(hit), dtype=np.float32)).irradiance(most)[-1]
    found = np.where(hit[:, None] >= 0, known[hit] * even.reflectance, 0) + np.pi * even.radiance
    brought, region = found.mean(axis=1), places.regions[even.point]
    guide = Guide(region, even.square, brought)
    further = gather_seen(scene, points, even.point, guide.squares(region, random), _state(random))
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


# Points of each generation.
POINTS = 1 << 17
# Rays from each point in even directions, and as many that are guided by what these bring.
_RAYS = 2
# Points of a cell are looked at from this height above the surface, in sides of the cell.
_HEIGHT = 0.1
# Points where paths of the views end, points seen from those, and so on.
_GENERATIONS = 3


def segments_beyond_cache(scene: Scene) -> int:
    """Segments that a path may take beyond the cache, after its first two; at least 1, -1 for no bound."""
    return max(1, scene.max_depth - 2) if scene.max_depth >= 0 else -1


def at_depth_of(scene: Scene, cache: IrradianceCache) -> IrradianceCache:
    """A cache of a scene that was filled at another path depth, in the light of that of the scene."""
    transfer = cache.transfer
    return replace(cache, irradiance=transfer.irradiance(segments_beyond_cache(scene))[:, transfer.known])


def fill_cache(
    scene: Scene,
    cameras: Sequence[Camera],
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
    points: int = POINTS,
) -> IrradianceCache:
    """A cache of the irradiance that paths from some views, at least one, will ask for.

    Each generation has a number of points. Progress is told steps done and steps in all. Same seed, same
    cache on the same machine. In participating media nothing is known, so that no path ends in it.
    """
    random = np.random.default_rng(seed)
    total = _GENERATIONS + 2
    distance = scene.surfaces().median_distance(cameras[0])
    scale = distance if np.isfinite(distance) else float(dr.max(scene.mitsuba.bbox().extents()))
    grid = Grid(cameras[0].position.astype(np.float32), scale)
    if scene.optics.has_media:
        return IrradianceCache.empty(len(scene.mitsuba.emitters()))
    share = -(-points // (2 * len(cameras)))
    every = joined_points([_path_ends(scene.traced, c, share, _state(random)) for c in cameras])
    if not len(every):
        return IrradianceCache.empty(len(scene.mitsuba.emitters()))
    seen = [_seen_evenly(scene.traced, every, random)]
    progress(1, total)
    for generation in range(1, _GENERATIONS):
        # What is seen from there must be known as well, to know what it reflects.
        further = _unknown(seen[-1], every, grid, points, random)
        if not len(further):
            break
        every = joined_points([every, further])
        seen.append(_seen_evenly(scene.traced, further, random))
        progress(generation + 1, total)
    cells = Cells.of(every, grid, lambda one, other, side: _joined(scene.mitsuba, every, one, other, side))
    direct, samples = gather_direct(scene.traced, every, _state(random))
    places = GuidedPlaces(every, cells, direct)
    progress(total - 1, total)
    most = segments_beyond_cache(scene)
    even = replace(Seen.joined(seen), point=np.repeat(np.arange(len(every)), _RAYS))
    transfer = guided_transfer(scene.traced, places, even, most, random)
    irradiance = transfer.irradiance(most)
    progress(total, total)
    lights = LightChoice.of(samples, every, grid, len(scene.mitsuba.emitters()))
    return IrradianceCache(cells.only_known(), irradiance[:, cells.known], lights, shuffled(transfer, random))


def _seen_evenly(scene: AnyScene, points: Points, random: np.random.Generator) -> Seen:
    square = even_squares(len(points), _RAYS, random)
    return gather_seen(scene, points, np.repeat(np.arange(len(points)), _RAYS), square, _state(random))


def _unknown(seen: Seen, known: Points, grid: Grid, count: int, random: np.random.Generator) -> Points:
    """Points that rays hit, first of all where none is known yet."""
    hits = seen.hits.take(random.permutation(np.flatnonzero(seen.valid)))
    # The largest cells contain the others.
    coarsest = len(SIDES) - 1
    old = np.isin(grid.keys(hits, coarsest), grid.keys(known, coarsest))
    return hits.take(np.argsort(old, kind="stable")[:count])


def _state(random: np.random.Generator) -> int:
    return int(random.integers(1 << 32))


def _path_ends(scene: AnyScene, camera: Camera, count: int, seed: int) -> Points:
    """Where paths of a camera are scattered first, and where they arrive then."""
    sampler = random_numbers(dr.opaque(mi.UInt32, seed), count)
    width, height = dr.opaque(mi.Float, camera.width), dr.opaque(mi.Float, camera.height)
    ray = ray_through(opaque_camera(camera), sampler.next_1d() * width, sampler.next_1d() * height)
    seen: Any = first_hits(scene, ray, mi.Bool(True)).last
    valid = seen.is_valid()
    sample, weight = seen.bsdf().sample(mi.BSDFContext(), seen, sampler.next_1d(), sampler.next_2d(), valid)
    valid &= dr.max(weight) > 0
    hit: Any = first_hits(scene, seen.spawn_ray(seen.to_world(sample.wo)), valid).last
    valid &= hit.is_valid() & mi.has_flag(hit.bsdf().flags(), mi.BSDFFlags.Smooth)
    found = [(at.p, mi.Vector3f(dr.select(at.wi.z > 0, at.n, -at.n)), valid) for at in (seen, hit)]
    dr.eval(found)
    return joined_points([Points(p.numpy().T, n.numpy().T).take(valid.numpy()) for p, n, valid in found])


def _joined(scene: mi.Scene, points: Points, one: Indices, other: Indices, side: float) -> Mask:
    """Whether nothing lies between points, seen from a little above their surfaces."""
    if not len(one):
        return np.ones(0, dtype=bool)
    raised = points.position + np.float32(_HEIGHT * side) * points.normal
    start, way = raised[one], raised[other] - raised[one]
    # By its stub, no length may be a number.
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(way.T), 1.0, 0.0, [])  # type: ignore[call-overload]
    blocked: Mask = scene.ray_test(ray, dr.squared_norm(ray.d) > 0).numpy()
    return ~blocked
