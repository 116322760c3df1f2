"""Fills a cache of irradiance: where paths from some views end, the light of the scene is sampled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from pathtrace.cache.cells import SIDES, Cells, Grid, Points, joined_points
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.cache.light_selection import LightChoice
from pathtrace.fill.gather import Seen, gather_direct, gather_seen
from pathtrace.fill.guiding import GuidedPlaces, even_squares, guided_transfer, shuffled
from pathtrace.scene.scene import Scene
from pathtrace.trace.film import opaque_camera, ray_through
from pathtrace.trace.first_hit import first_hits

# Points of each generation.
POINTS = 1 << 17
# Rays from each point in even directions, and as many that are guided by what these bring.
_RAYS = 2
# Points of a cell are looked at from this height above the surface, in sides of the cell.
_HEIGHT = 0.1
# Points where paths of the views end, points seen from those, and so on.
_GENERATIONS = 3


def segments_beyond_cache(scene: Scene) -> int:
    """Segments that a path may take beyond the cache, at least 1; -1 for no bound.

    One of a path's segments leads to the first surface, and one from there to the cache.
    """
    return max(1, scene.max_depth - 2) if scene.max_depth >= 0 else -1


def fill_cache(
    scene: Scene,
    cameras: Sequence[Camera],
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
    points: int = POINTS,
) -> IrradianceCache:
    """A cache of the irradiance that paths from some views, at least one, will ask for.

    Each generation has a number of points. Progress is told the steps done and the steps in all. Same seed,
    same cache on the same machine. In participating media nothing is known, so that no path ends in it.
    """
    random = np.random.default_rng(seed)
    total = _GENERATIONS + 2
    grid = Grid(cameras[0].position.astype(np.float32), _scale(scene, cameras[0]))
    if scene.optics.has_media:
        return IrradianceCache.empty(grid, len(scene.mitsuba.emitters()))
    share = -(-points // (2 * len(cameras)))
    ends = [_path_ends(scene.traced, camera, share, _state(random)) for camera in cameras]
    parts = [joined_points(ends)]
    if not len(parts[0]):
        return IrradianceCache.empty(grid, len(scene.mitsuba.emitters()))
    seen = [_seen_evenly(scene.traced, parts[0], random)]
    progress(1, total)
    for generation in range(1, _GENERATIONS):
        # What is seen from there must be known as well, to know what it reflects.
        further = _unknown(seen[-1], joined_points(parts), grid, points, random)
        if not len(further):
            break
        parts.append(further)
        seen.append(_seen_evenly(scene.traced, further, random))
        progress(generation + 1, total)
    every = joined_points(parts)
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


def _seen_evenly(scene: Any, points: Points, random: np.random.Generator) -> Seen:
    """What is seen from points in even directions."""
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


def _scale(scene: Scene, camera: Camera) -> float:
    distance = scene.surfaces().median_distance(camera)
    return distance if np.isfinite(distance) else float(dr.max(scene.mitsuba.bbox().extents()))


def _path_ends(scene: Any, camera: Camera, count: int, seed: int) -> Points:
    """Where paths of a camera are scattered first, and where they arrive then."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), count)
    width, height = dr.opaque(mi.Float, camera.width), dr.opaque(mi.Float, camera.height)
    ray = ray_through(opaque_camera(camera), sampler.next_1d() * width, sampler.next_1d() * height)
    seen = first_hits(scene, ray, mi.Bool(True)).last
    valid = seen.is_valid()
    sample, weight = seen.bsdf().sample(mi.BSDFContext(), seen, sampler.next_1d(), sampler.next_2d(), valid)
    valid &= dr.max(weight) > 0
    hit = first_hits(scene, seen.spawn_ray(seen.to_world(sample.wo)), valid).last
    valid &= hit.is_valid() & mi.has_flag(hit.bsdf().flags(), mi.BSDFFlags.Smooth)
    found = [(at.p, mi.Vector3f(dr.select(at.wi.z > 0, at.n, -at.n)), valid) for at in (seen, hit)]
    dr.eval(found)
    return joined_points([Points(p.numpy().T, n.numpy().T).take(valid.numpy()) for p, n, valid in found])


def _joined(
    scene: Any, points: Points, one: NDArray[np.int64], other: NDArray[np.int64], side: float
) -> NDArray[np.bool_]:
    """Whether nothing lies between points, seen from a little above their surfaces."""
    if not len(one):
        return np.ones(0, dtype=bool)
    raised = points.position + np.float32(_HEIGHT * side) * points.normal
    start, way = raised[one], raised[other] - raised[one]
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(way.T), 1.0, 0.0, [])
    blocked: NDArray[np.bool_] = scene.ray_test(ray, dr.squared_norm(ray.d) > 0).numpy()
    return ~blocked
