"""How the light on the nodes of a forest changes over time, as the path tracer finds it.

Trained on frames of many times, a node has a radiance between the median and the mean of theirs. The path
tracer knows the irradiance where the node is, at any time: their ratio is the node's factor, and no step of
training is spent on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mitsuba as mi
import numpy as np
import torch
from numpy.typing import NDArray

from compose.camera.camera import Camera
from hybrid.runtime.progress import Bars
from pathtrace.cache.cache import IrradianceCache
from pathtrace.cache.cells import Points
from pathtrace.fill.over_time import irradiance_over_time
from pathtrace.scene.scene import Scene
from splat.model.forest import Forest
from splat.model.light_course import LightCourse

# Times at which irradiance is found: so many in a second of the scene, within limits.
_PER_SECOND, _LEAST_TIMES, _MOST_TIMES = 30, 33, 513
# Change of the factor from which a node has a course.
_LEAST_CHANGE = 0.08
# Largest factor: where there is no light most of the time, ratios mean nothing.
_LARGEST = 8.0
# Views from which nodes are looked for on surfaces, at most.
_VIEWS = 48
# A surface is that of a node within so many standard deviations, and this share of the distance.
_REACH, _SHARE = 2.0, 2e-3
# Irradiance that counts as none, as a share of the mean.
_DARK = 1e-3
# Of the curve on which training compares radiance, about.
_GAMMA = 2.2


def with_light_course(
    forest: Forest, scene: Scene, cache: IrradianceCache, cameras: Sequence[Camera], seed: int, bars: Bars
) -> Forest:
    """The forest with factors for the still nodes whose light changes; as it is if none does.

    Those that move have none: on thin shapes, lit from either side, factors did more harm than good.

    Args:
        forest: of the scene.
        scene: one that moves.
        cache: of its irradiance at time 0.
        cameras: of the training views, from which nodes are looked for on surfaces.
        seed: same seed, same factors on the same machine.
        bars: show the progress.
    """
    scene.set_time(0.0)
    nodes = forest.nodes.gaussians
    positions = forest.place.in_world(nodes.means.detach().numpy().T)
    longest = nodes.log_scales.detach().max(dim=0).values.exp().double().numpy()
    chosen = cameras[:: max(1, len(cameras) // _VIEWS)]
    points, found = _on_still_surfaces(scene, positions, _REACH * forest.place.unit * longest, chosen)
    still = np.flatnonzero(found & (forest.nodes.semantic.numpy() < 0))
    if not len(still):
        return forest
    with bars("light over time") as bar:
        irradiance = irradiance_over_time(scene, cache, points.take(still), _times(scene), seed, bar)
    factors = _of_usual(irradiance)
    changes = np.ptp(factors, axis=0) > _LEAST_CHANGE
    if not changes.any():
        return forest
    course = LightCourse(
        torch.from_numpy(still[changes]), torch.from_numpy(factors[:, changes].astype(np.float32))
    )
    return replace(forest, light=course)


def _times(scene: Scene) -> list[float]:
    seconds = 0.0 if scene.moving is None else scene.moving.motion.seconds
    count = min(max(round(seconds * _PER_SECOND) + 1, _LEAST_TIMES), _MOST_TIMES)
    return [float(time) for time in np.linspace(0, 1, count)]


def _of_usual(irradiance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Irradiance (T, N) over that which training has seen most of, up to a limit."""
    seen = irradiance.astype(np.float64)
    perceived = (seen ** (1 / _GAMMA)).mean(axis=0) ** _GAMMA
    usual = (np.median(seen, axis=0) + perceived) / 2
    least = max(_DARK * float(usual.mean()), 1e-12)
    return np.minimum((seen + least) / (usual + least), _LARGEST)


def _on_still_surfaces(
    scene: Scene, positions: NDArray[np.float64], reach: NDArray[np.float64], cameras: Sequence[Camera]
) -> tuple[Points, NDArray[np.bool_]]:
    """Points (N) of what stands still in a scene where nodes are; and which nodes have one."""
    moving = [] if scene.moving is None else [mi.ShapePtr(shape) for shape in scene.moving.shapes]
    found = np.zeros(len(positions), dtype=bool)
    place, normal = np.zeros((2, len(positions), 3), dtype=np.float32)
    for camera in cameras:
        pixels, depth = camera.project(positions)
        inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1) & (depth > 0)
        asked = np.flatnonzero(inside & ~found)
        if not len(asked):
            continue
        way = positions[asked] - camera.position
        distance = np.linalg.norm(way, axis=1)
        direction = (way / distance[:, None]).astype(np.float32)
        ray = mi.Ray3f(mi.Point3f(camera.position.astype(np.float32)), mi.Vector3f(direction.T))
        hit = scene.mitsuba.ray_intersect(ray)
        valid = hit.is_valid()
        for shape in moving:
            valid &= hit.shape != shape
        away, valid = hit.t.numpy(), valid.numpy()
        near = valid & (np.abs(away - distance) < reach[asked] + _SHARE * distance)
        facing = hit.n.numpy().T
        facing *= np.where((facing * direction).sum(axis=1) > 0, -1, 1)[:, None]
        place[asked[near]], normal[asked[near]] = hit.p.numpy().T[near], facing[near]
        found[asked[near]] = True
    return Points(place, normal), found
