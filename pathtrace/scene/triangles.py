"""The scene's surfaces as triangles in an Embree tree: free space, and what is visible from a point."""

from __future__ import annotations

from typing import Any, Protocol

import mitsuba as mi
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from compose.camera.camera import Camera

_Array = NDArray[np.float64]

_SPHERE_RINGS = 24
_CIRCLE_STEPS = 48


def triangles_of(shape: Any) -> _Array | None:
    """(M, 3, 3) corners of a Mitsuba shape's triangles in world space; None if unsupported."""
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


def _unit_shape(kind: str) -> tuple[_Array, NDArray[np.int32]] | None:
    """Vertices (V, 3) and triangles (M, 3) of an analytic shape in its own coordinates."""
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


def _grid_triangles(rows: int, columns: int) -> NDArray[np.int32]:
    """(M, 3) vertex indices: two triangles per cell of a (rows x columns) grid of vertices."""
    corner = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, : columns - 1].ravel()
    lower = np.stack([corner, corner + 1, corner + columns], axis=1)
    upper = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1)
    return np.concatenate([lower, upper]).astype(np.int32)


Array = NDArray[np.float64]

# Side of the coarse frame, in pixels, whose rays probe what a camera sees.
_PROBE = 24
_CLEARANCE_DIRECTIONS = 256


class Loaded(Protocol):
    """Whatever holds a Mitsuba scene, such as `pathtrace.scene.scene.Scene`."""

    @property
    def mitsuba(self) -> Any:
        """The Mitsuba scene."""


class Surfaces:
    """All surfaces of a scene in one Embree tree.

    Args:
        scene: the scene; analytic shapes are tessellated.

    Attributes:
        untessellated: class names of shapes that could not be turned into triangles and are missing here.
        bounds: (3,) lowest and (3,) highest corner of all triangles; inf and -inf if there are none.
    """

    def __init__(self, scene: Loaded):
        self._embree = EmbreeScene()
        self.untessellated: list[str] = []
        parts = []
        for shape in scene.mitsuba.shapes():
            triangles = triangles_of(shape)
            if triangles is None:
                self.untessellated.append(shape.class_name())
            else:
                parts.append(triangles)
        corners = np.concatenate(parts) if parts else np.zeros((0, 3, 3))
        points = corners.reshape(-1, 3)
        self.bounds = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
        if len(corners):
            TriangleMesh(self._embree, np.ascontiguousarray(corners, dtype=np.float32))

    def distance(self, origins: Array, directions: Array) -> Array:
        """(N,) distance to the first surface along N rays; inf where there is none.

        Args:
            origins: (N, 3) points.
            directions: (N, 3) unit vectors.
        """
        found = self._embree.run(
            np.ascontiguousarray(origins, dtype=np.float32),
            np.ascontiguousarray(directions, dtype=np.float32),
            query="DISTANCE",
        )
        return _infinite_where_missed(found)

    def hits(self, origins: Array, directions: Array) -> tuple[Array, Array]:
        """Distance (N,) to the first surface along N rays, and its unit normal (N, 3), which faces the ray.

        Args:
            origins: (N, 3) points.
            directions: (N, 3) unit vectors.

        Returns:
            inf and zeros where there is no surface.
        """
        found = self._embree.run(
            np.ascontiguousarray(origins, dtype=np.float32),
            np.ascontiguousarray(directions, dtype=np.float32),
            query="INTERSECT",
            output=True,
        )
        distance = _infinite_where_missed(found["tfar"])
        normal = np.asarray(found["Ng"], dtype=np.float64)
        length = np.linalg.norm(normal, axis=1)
        facing = -np.sign(np.sum(normal * directions, axis=1)) / np.where(length > 0, length, 1)
        return distance, np.where(np.isfinite(distance), facing, 0)[:, None] * normal

    def clearances(self, points: Array, directions: Array) -> Array:
        """(N,) distance from N points (N, 3) to the nearest surface along any of the directions (M, 3)."""
        return self.around(points, directions).min(axis=1, initial=np.inf)

    def around(self, points: Array, directions: Array) -> Array:
        """(N, M) distance from each of N points (N, 3) along each of M directions (M, 3)."""
        origins = np.repeat(points, len(directions), axis=0)
        return self.distance(origins, np.tile(directions, (len(points), 1))).reshape(
            len(points), len(directions)
        )

    def are_joined(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """(N,) whether no surface lies on the straight lines between points (N, 3) and (N, 3)."""
        ways = ends - starts
        lengths = np.linalg.norm(ways, axis=1)
        distance = self.distance(starts, ways / np.where(lengths > 0, lengths, 1)[:, None])
        return (lengths == 0) | (distance > lengths)

    def clearance(self, point: Array) -> float:
        """Distance from a point (3,) to the nearest surface, over a fixed set of directions."""
        return float(self.clearances(point[None], sphere_directions(_CLEARANCE_DIRECTIONS))[0])

    def sees(self, start: Array, end: Array) -> bool:
        """Whether no surface lies on the straight line between two points (3,)."""
        return bool(self.are_joined(start[None], end[None])[0])

    def probe(self, camera: Camera) -> Array:
        """(24 * 24,) distances to what a camera sees over a coarse grid of rays; inf if nothing."""
        small = camera.resized(_PROBE, _PROBE)
        directions = small.rays(small.pixel_centres())
        return self.distance(np.repeat(camera.position[None], len(directions), axis=0), directions)

    def median_distance(self, camera: Camera) -> float:
        """Median distance to what a camera sees; inf if it sees nothing."""
        distance = self.probe(camera)
        seen = distance[np.isfinite(distance)]
        return float(np.median(seen)) if len(seen) else np.inf


def _infinite_where_missed(found: Any) -> Array:
    distance = np.asarray(found, dtype=np.float64)
    # Embree marks a miss with the largest distance it was given.
    return np.where(distance >= 1e30, np.inf, distance)


def sphere_directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere: a Fibonacci lattice."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    turn = index * np.pi * (1 + 5**0.5)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
