"""The scene's surfaces as triangles in Embree: what is free space, and what a point sees."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from pathtrace.scene.scene import Scene

Array = NDArray[np.float64]

_SPHERE_RINGS = 24
_CIRCLE_STEPS = 48


def _grid_triangles(rows: int, columns: int) -> NDArray[np.int32]:
    """Two triangles per cell of a (rows x columns) grid of vertices, (M, 3)."""
    corner = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, : columns - 1].ravel()
    lower = np.stack([corner, corner + 1, corner + columns], axis=1)
    upper = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1)
    return np.concatenate([lower, upper]).astype(np.int32)


def _unit_shape(kind: str) -> tuple[Array, NDArray[np.int32]] | None:
    """Vertices and triangles of Mitsuba's analytic shapes in their own coordinates."""
    turn = np.linspace(0, 2 * np.pi, _CIRCLE_STEPS + 1)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    zero, one = np.zeros((len(turn), 1)), np.ones((len(turn), 1))
    if kind == "Rectangle":
        corners = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]], dtype=np.float64)
        return corners, _grid_triangles(2, 2)
    if kind == "Disk":
        rim = np.hstack([circle, zero])
        return np.concatenate([rim * 0, rim]), _grid_triangles(2, len(turn))
    if kind == "Cylinder":
        rim = np.hstack([circle, zero])
        return np.concatenate([rim, rim + np.hstack([zero, zero, one])]), _grid_triangles(2, len(turn))
    if kind == "Sphere":
        polar = np.linspace(0, np.pi, _SPHERE_RINGS)[:, None]
        ring = [np.sin(polar) * circle[:, 0], np.sin(polar) * circle[:, 1], np.cos(polar) + 0 * turn]
        return np.stack(ring, axis=-1).reshape(-1, 3), _grid_triangles(_SPHERE_RINGS, len(turn))
    return None


def _triangles(shape: Any) -> Array | None:
    """(M, 3, 3) corners in world space, None for a kind of shape that has no surface here."""
    parameters = mi.traverse(shape)
    if "vertex_positions" in parameters:
        vertices = np.array(parameters["vertex_positions"]).reshape(-1, 3)
        faces = np.array(parameters["faces"]).reshape(-1, 3)
        return vertices[faces].astype(np.float64)
    unit = _unit_shape(shape.class_name())
    if unit is None or "to_world" not in parameters:
        return None
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    vertices = unit[0] @ matrix[:3, :3].T + matrix[:3, 3]
    return vertices[unit[1]]


class Surfaces:
    """All surfaces of a scene in one Embree tree.

    Attributes:
        untessellated: kinds of shape that could not be turned into triangles and are not seen here.
    """

    def __init__(self, scene: Scene):
        self._embree = EmbreeScene()
        self.untessellated: list[str] = []
        parts = []
        for shape in scene.mitsuba.shapes():
            triangles = _triangles(shape)
            if triangles is None:
                self.untessellated.append(shape.class_name())
            else:
                parts.append(triangles)
        corners = np.concatenate(parts) if parts else np.zeros((0, 3, 3))
        if len(corners):
            TriangleMesh(self._embree, np.ascontiguousarray(corners, dtype=np.float32))

    def distance(self, origins: Array, directions: Array) -> Array:
        """Distance to the first surface along unit directions, inf where there is none; (N, 3) -> (N,)."""
        found = self._embree.run(
            np.ascontiguousarray(origins, dtype=np.float32),
            np.ascontiguousarray(directions, dtype=np.float32),
            query="DISTANCE",
        )
        distance = np.asarray(found, dtype=np.float64)
        # Embree marks a miss with the largest distance it was given.
        return np.where(distance >= 1e30, np.inf, distance)

    def clearance(self, point: Array) -> float:
        """Distance from a point (3,) to the nearest surface, over a fixed set of directions."""
        directions = sphere_directions(256)
        return float(self.distance(np.repeat(point[None], len(directions), axis=0), directions).min())

    def sees(self, start: Array, end: Array) -> bool:
        """Whether the straight way between two points (3,) is free."""
        way = end - start
        length = float(np.linalg.norm(way))
        return length == 0 or float(self.distance(start[None], way[None] / length)[0]) > length


def sphere_directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere: a Fibonacci lattice."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    turn = index * np.pi * (1 + 5**0.5)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
