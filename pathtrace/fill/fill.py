"""Fills a cache of irradiance: where paths from some views end, the light of the scene is sampled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from pathtrace.cache.cache import IrradianceCache
from pathtrace.cache.cells import SIDES, Cells, Grid, Points
from pathtrace.cache.lights import LightChoice, LightSamples
from pathtrace.cache.patches import Patches, sums_by
from pathtrace.cache.transfer import Rays, Transfer
from pathtrace.cache.transport import Links, Transport
from pathtrace.fill.direct import RAYS
from pathtrace.fill.gather import Gathered, gather
from pathtrace.fill.segments import segments_beyond_cache
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces
from pathtrace.trace.first_hit import first_hits
from pathtrace.trace.rays import opaque_camera, ray_through

# Points of each generation.
POINTS = 1 << 17
# Points of a cell are looked at from this height above the surface, in sides of the cell.
_HEIGHT = 0.1
# Points where paths of the views end, points seen from those, and so on.
_GENERATIONS = 3


def fill_cache(
    scene: Scene,
    cameras: Sequence[Camera],
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
    points: int = POINTS,
) -> IrradianceCache:
    """A cache of the irradiance that paths from some views will ask for.

    Args:
        scene: the scene.
        cameras: the views; at least one.
        seed: same seed, same cache on the same machine.
        progress: called with steps done and steps in all.
        points: number of points of each generation.
    """
    random = np.random.default_rng(seed)
    state = lambda: int(random.integers(1 << 32))  # noqa: E731
    total = _GENERATIONS + 1
    grid = Grid(cameras[0].position.astype(np.float32), _scale(scene, cameras[0]))
    share = -(-points // (2 * len(cameras)))
    parts = [_concatenated([_path_ends(scene.mitsuba, camera, share, state()) for camera in cameras])]
    if not len(parts[0]):
        return IrradianceCache.empty(grid, len(scene.mitsuba.emitters()))
    gathered = [gather(scene.mitsuba, parts[0], state())]
    progress(1, total)
    for generation in range(1, _GENERATIONS):
        # What is seen from there must be known as well, to know what it reflects.
        seen = _seen(gathered[-1], _concatenated(parts), grid, points, random)
        if not len(seen):
            break
        parts.append(seen)
        gathered.append(gather(scene.mitsuba, seen, state()))
        progress(generation + 1, total)
    every = _concatenated(parts)
    joined = lambda one, other, side: _joined(scene.mitsuba, every, one, other, side)  # noqa: E731
    cells = Cells.of(every, grid, joined)
    transfer = _transfer(gathered, every, cells, random)
    direct = transfer.of_cells(transfer.direct, transfer.reflected)
    irradiance = transfer.transport.irradiance(direct, segments_beyond_cache(scene))
    progress(total, total)
    lights = LightChoice.of(_light_samples(gathered), every, grid, len(scene.mitsuba.emitters()))
    return IrradianceCache(cells.only_known(), irradiance[:, cells.known], lights, transfer)


def _transfer(
    gathered: Sequence[Gathered], points: Points, cells: Cells, random: np.random.Generator
) -> Transfer:
    """What rays from points found, summed over patches; the points in another order."""
    patches, patch = Patches.of(cells.indices(points), len(cells))
    transport = Transport.of(_links(gathered, cells), patches, patch)
    direct = sums_by(patch, _joint(gathered, "direct"), len(patches))
    region = patches.regions[patch]
    reflected = sums_by(region, _joint(gathered, "reflected"), int(patches.regions.max()) + 1)
    order = random.permutation(len(points)).astype(np.int32)
    place = np.empty_like(order)
    place[order] = np.arange(len(order), dtype=np.int32)
    shiny = random.permutation(np.flatnonzero(_joint(gathered, "shiny")))
    rays = Rays(place[shiny // RAYS], _joint(gathered, "square")[shiny])
    light = direct.astype(np.float32), reflected.astype(np.float32)
    return Transfer(points.take(order), patch[order], rays, *light, transport, cells.known)


def _seen(
    gathered: Gathered,
    known: Points,
    grid: Grid,
    count: int,
    random: np.random.Generator,
) -> Points:
    """Points that rays hit, first of all where none is known yet."""
    hits = gathered.hits.take(random.permutation(np.flatnonzero(gathered.valid)))
    # The largest cells contain the others.
    coarsest = len(SIDES) - 1
    old = np.isin(grid.keys(hits, coarsest), grid.keys(known, coarsest))
    return hits.take(np.argsort(old, kind="stable")[:count])


def _scale(scene: Scene, camera: Camera) -> float:
    distance = Surfaces(scene).median_distance(camera)
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
    return _concatenated([Points(p.numpy().T, n.numpy().T).take(valid.numpy()) for p, n, valid in found])


def _links(parts: Sequence[Gathered], cells: Cells) -> Links:
    """The rays whose hits lie in cells, and those that left the scene."""
    cell = cells.best(_concatenated([part.hits for part in parts]))
    valid, bounces, reflectance = (_joint(parts, name) for name in ("valid", "bounces", "reflectance"))
    # Rays that hit no cell are left out, as if they had found what the others did.
    kept = np.flatnonzero(~valid | (cell >= 0))
    cell = np.where(valid, cell, -1)
    return Links(kept // RAYS, cell[kept], bounces[kept], reflectance[kept])


def _light_samples(parts: Sequence[Gathered]) -> LightSamples:
    start, points = 0, []
    for part in parts:
        points.append(start + part.lights.point)
        start += len(part.direct)
    light, irradiance = (
        np.concatenate([getattr(part.lights, name) for part in parts]) for name in ("light", "irradiance")
    )
    return LightSamples(np.concatenate(points), light, irradiance)


def _joint(parts: Sequence[Gathered], name: str) -> NDArray[Any]:
    """Values of all parts, one after the other."""
    return np.concatenate([getattr(part, name) for part in parts])


def _concatenated(parts: Sequence[Points]) -> Points:
    return Points(
        np.concatenate([part.position for part in parts]), np.concatenate([part.normal for part in parts])
    )


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
