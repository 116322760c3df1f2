"""Which nodes of a forest lie on what moves, as the scene itself tells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compose.camera.coordinate_systems import Place
from pathtrace.scene.moving_scene import MovingScene
from pathtrace.scene.scene import Scene
from pathtrace.scene.triangles import triangles_of
from splat.model.motion import Dynamics
from splat.model.points import remoteness
from splat.model.trees import Layer

Array = NDArray[np.float64]


class Placed(Protocol):
    """Whatever holds nodes in a place, such as a forest or its trainer."""

    @property
    def place(self) -> Place:
        """The coordinates of the nodes, in those of the scene."""

    @property
    def motion(self) -> Dynamics | None:
        """Of the instances that nodes belong to."""


# Points that stand for surfaces while the nearest triangle is sought, and how many of the nearest are tried.
_SAMPLES, _TRIED = 100_000, 3


class Triangles:
    """Distances to triangles.

    Args:
        corners: (F, 3, 3), one or more.
    """

    def __init__(self, corners: Array):
        self._corners = corners
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        counts = 1 + np.floor(_SAMPLES * area / max(area.sum(), 1e-300)).astype(np.int64)
        self._triangle = np.repeat(np.arange(len(corners)), counts)
        u, v = np.random.default_rng(0).random((2, len(self._triangle), 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        of = self._triangle
        points = corners.reshape(-1, 3)
        self._low, self._high = points.min(axis=0), points.max(axis=0)
        self._tree = cKDTree(a[of] + u * (b - a)[of] + v * (c - a)[of])

    def within(self, points: Array, distance: Array) -> NDArray[np.bool_]:
        """(N,) whether points (N, 3) may be within distances (N,): whether the box around all is."""
        beside = np.maximum(np.maximum(self._low - points, points - self._high), 0)
        return np.linalg.norm(beside, axis=1) < distance

    def distance(self, points: Array) -> Array:
        """(N,) distance of points (N, 3) to the nearest triangle, among those with the nearest samples."""
        _, near = self._tree.query(points, k=min(_TRIED, self._tree.n))
        near = near.reshape(len(points), min(_TRIED, self._tree.n))
        tried = [_to_triangles(points, self._corners[self._triangle[column]]) for column in near.T]
        return np.min(tried, axis=0)


def _to_triangles(points: Array, corners: Array) -> Array:
    """(N,) distance of each point (N, 3) to one triangle (N, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, 1)
    inside = length[:, 0] > 0
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(end - start, points - start) * normal).sum(axis=1) >= 0
    edges = np.min([_to_edges(points, start, end) for start, end in ((a, b), (b, c), (c, a))], axis=0)
    return np.where(inside, np.abs(((points - a) * normal).sum(axis=1)), edges)


def _to_edges(points: Array, start: Array, end: Array) -> Array:
    """(N,) distance of each point (N, 3) to one edge, between two points (N, 3)."""
    way = end - start
    square = np.maximum((way**2).sum(axis=1), 1e-300)
    part = np.clip(((points - start) * way).sum(axis=1) / square, 0, 1)
    return np.linalg.norm(points - start - part[:, None] * way, axis=1)


def nodes_that_move(
    scene: Scene, moving: MovingScene, nodes: Placed, layer: Layer, times: Sequence[float]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which nodes lie on what moves, by the scene's surfaces and no image.

    A node moves if it goes with what moves: as it is shown, its centre is nearer to a surface of that than to
    one that stands still, by the medians over the times. It counts as moving as well if it belongs to what
    moves although it stands still: it is farther from all that stands still than it is large (its longest
    standard deviation), and at one of the times a surface of what moves is nearer.

    Args:
        scene: which moves; in the end it is at the last time.
        moving: what moves of it.
        nodes: the place and the motion that the nodes have.
        layer: N nodes of it, at rest.
        times: from 0 to 1.

    Returns:
        (N,) whether a node moves, and (N,) whether it counts: nodes of the sky lie on nothing.
    """
    counts = remoteness(layer.gaussians.means).numpy() == 1
    kept = torch.from_numpy(np.flatnonzero(counts))
    moves = np.zeros(len(layer), dtype=bool)
    moves[counts] = _move(scene, moving, nodes, layer.select(kept), times)
    return moves, counts


def _move(
    scene: Scene, moving: MovingScene, nodes: Placed, layer: Layer, times: Sequence[float]
) -> NDArray[np.bool_]:
    """(N,) which of the nodes move, the sky apart; as of `nodes_that_move`."""
    tracked = {shape.id() for shape in moving.shapes}
    still = _triangles(scene, tracked, False)
    dynamic = np.flatnonzero(layer.dynamic.numpy())
    to_still = np.tile(still.distance(_shown(nodes, layer, times[0])), (len(times), 1))
    # What is farther from the box around all that moves than from what stands still is not asked for more.
    to_moving = np.full(to_still.shape, np.inf)
    for number, time in enumerate(times):
        points = _shown(nodes, layer, time)
        to_still[number, dynamic] = still.distance(points[dynamic])
        moving.set_time(time)
        surfaces = _triangles(scene, tracked, True)
        near = np.flatnonzero(surfaces.within(points, to_still[number]))
        to_moving[number, near] = surfaces.distance(points[near])
    size = nodes.place.unit * layer.gaussians.log_scales.max(dim=0).values.exp().double().numpy()
    goes_along = np.median(to_moving, axis=0) < np.median(to_still, axis=0)
    is_passed = ((to_moving < to_still) & (to_still > size)).any(axis=0)
    return goes_along | is_passed


def _triangles(scene: Scene, tracked: set[str], moves: bool) -> Triangles:
    """Those of the shapes that move, or of the others, as they are now."""
    shapes = [shape for shape in scene.mitsuba.shapes() if (shape.id() in tracked) == moves]
    found = [triangles_of(shape) for shape in shapes]
    return Triangles(np.concatenate([part for part in found if part is not None]).astype(np.float64))


def _shown(nodes: Placed, layer: Layer, time: float) -> Array:
    """(N, 3) centres of nodes at a time, in the scene's coordinates."""
    gaussians = layer.gaussians
    if nodes.motion is not None:
        with torch.no_grad():
            gaussians = nodes.motion.shown(gaussians, layer.semantic, time)
    return nodes.place.in_world(gaussians.means.T.numpy())
