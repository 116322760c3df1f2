"""The scene's surfaces as triangles in an Embree tree: free space, and what is visible from a point."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera, sphere_directions
from pathtrace.scene.instances import AnyScene

_SPHERE_RINGS = 24
_CIRCLE_STEPS = 48
# Side of the coarse frame, in pixels, whose rays probe what a camera sees.
_PROBE = 24
# Directions in which the nearest surface to a point is looked for: to a single one, and to many.
_CLEARANCE_DIRECTIONS, _DIRECTIONS = 256, 96


def triangles_of(shape: mi.Shape) -> Array | None:
    """(M, 3, 3) corners of a shape's triangles in the world, None if unsupported; UserError if damaged."""
    parameters = mi.traverse(shape)
    if "vertex_positions" in parameters:
        vertices = np.array(parameters["vertex_positions"]).reshape(-1, 3)
        faces = np.array(parameters["faces"]).reshape(-1, 3)
        if len(faces) and faces.max() >= len(vertices):
            raise UserError(f"a mesh has {len(vertices)} vertices, and a face with number {faces.max()}")
        return vertices[faces].astype(np.float64)
    unit = _unit_shape(shape.class_name())
    if unit is None or "to_world" not in parameters:
        return None
    corners, triangles = unit
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    return (corners @ matrix[:3, :3].T + matrix[:3, 3])[triangles]


def _unit_shape(kind: str) -> tuple[Array, NDArray[np.int32]] | None:
    """Vertices (V, 3) and triangles (M, 3) of an analytic shape in its own coordinates."""
    turn = np.linspace(0, 2 * np.pi, _CIRCLE_STEPS + 1)
    rim = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    if kind == "Rectangle":
        corners = np.array([[-1, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]], dtype=np.float64)
        return corners, _grid_triangles(2, 2)
    if kind == "Disk":
        return np.concatenate([rim * 0, rim]), _grid_triangles(2, len(turn))
    if kind == "Cylinder":
        return np.concatenate([rim, rim + np.array([0, 0, 1])]), _grid_triangles(2, len(turn))
    if kind == "Sphere":
        polar = np.linspace(0, np.pi, _SPHERE_RINGS)[:, None]
        ring = [np.sin(polar) * rim[:, 0], np.sin(polar) * rim[:, 1], np.cos(polar) + 0 * turn]
        return np.stack(ring, axis=-1).reshape(-1, 3), _grid_triangles(_SPHERE_RINGS, len(turn))
    return None


def _grid_triangles(rows: int, columns: int) -> NDArray[np.int32]:
    """(M, 3) vertex indices: two triangles per cell of a (rows x columns) grid of vertices."""
    corner = np.arange((rows - 1) * columns).reshape(rows - 1, columns)[:, : columns - 1].ravel()
    lower = np.stack([corner, corner + 1, corner + columns], axis=1)
    upper = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1)
    return np.concatenate([lower, upper]).astype(np.int32)


class Surfaces:
    """All surfaces of a scene in one Embree tree, and their bounds: lowest and highest corner, (3,) each.

    Without a triangle, these are inf and -inf. Analytic shapes are tessellated; of a scene with instances,
    curves or other shapes that are not, rays are traced by Mitsuba.
    """

    def __init__(self, scene: AnyScene):
        self._embree = EmbreeScene()
        self._mitsuba: AnyScene | None = None
        parts = [np.zeros((0, 3, 3))]
        for shape in scene.shapes():
            part = triangles_of(shape)
            if part is None:
                self._mitsuba, box = scene, scene.bbox()
                self.bounds = np.array(box.min, np.float64).ravel(), np.array(box.max, np.float64).ravel()
                return
            parts.append(part)
        corners = np.concatenate(parts)
        points = corners.reshape(-1, 3)
        self.bounds = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
        if len(corners):
            TriangleMesh(self._embree, np.ascontiguousarray(corners, dtype=np.float32))

    def distance(self, origins: Array, directions: Array) -> Array:
        """(N,) distance to surfaces along rays from points (N, 3) in unit directions (N, 3); else inf."""
        if not len(origins):
            # Of no rays, Dr.Jit aborts the process.
            return np.zeros(0)
        if self._mitsuba is not None:
            found = self._mitsuba.ray_intersect_preliminary(_mitsuba_rays(origins, directions))
            return np.array(found.t, np.float64)
        return _infinite_where_missed(self._embree.run(*_as_rays(origins, directions), query="DISTANCE"))

    def hits(self, origins: Array, directions: Array) -> tuple[Array, Array]:
        """`distance`, and the surfaces' unit normals (N, 3), which face the rays; 0 where there is none."""
        if not len(origins):
            return np.zeros(0), np.zeros((0, 3))
        if self._mitsuba is not None:
            seen = self._mitsuba.ray_intersect(_mitsuba_rays(origins, directions))
            # In one kernel: each would trace all rays.
            dr.eval(seen.t, seen.n)
            distance, normal = np.array(seen.t, np.float64), np.array(seen.n, np.float64).T
        else:
            found = self._embree.run(*_as_rays(origins, directions), query="INTERSECT", output=True)
            distance = _infinite_where_missed(found["tfar"])
            normal = np.asarray(found["Ng"], dtype=np.float64)
        length = np.linalg.norm(normal, axis=1)
        facing = -np.sign(np.sum(normal * directions, axis=1)) / np.where(length > 0, length, 1)
        return distance, np.where(np.isfinite(distance), facing, 0)[:, None] * normal

    def clearances(self, points: Array, count: int = _DIRECTIONS) -> Array:
        """(N,) distance from points (N, 3) to the nearest surface in any of `count` fixed directions."""
        return self.around(points, sphere_directions(count)).min(axis=1, initial=np.inf)

    def around(self, points: Array, directions: Array) -> Array:
        """(N, M) distance from each of N points (N, 3) along each of M directions (M, 3)."""
        origins = np.repeat(points, len(directions), axis=0)
        distance = self.distance(origins, np.tile(directions, (len(points), 1)))
        return distance.reshape(len(points), len(directions))

    def are_joined(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """(N,) whether no surface lies on the straight lines between points (N, 3) and (N, 3)."""
        ways = ends - starts
        lengths = np.linalg.norm(ways, axis=1)
        distance = self.distance(starts, ways / np.where(lengths > 0, lengths, 1)[:, None])
        return (lengths == 0) | (distance > lengths)

    def clearance(self, point: Array) -> float:
        """Distance from a point (3,) to the nearest surface in any of 256 fixed directions."""
        return float(self.clearances(point[None], _CLEARANCE_DIRECTIONS)[0])

    def sees(self, start: Array, end: Array) -> bool:
        """Whether no surface lies on the straight line between two points (3,)."""
        return bool(self.are_joined(start[None], end[None])[0])

    def probe(self, camera: Camera) -> Array:
        """(24 * 24,) distances to what a camera sees over a coarse grid of rays; inf if nothing."""
        small = camera.resized(_PROBE, _PROBE)
        return self.around(camera.position[None], small.rays(small.pixel_centres()))[0]

    def median_distance(self, camera: Camera) -> float:
        """Median distance to what a camera sees; inf if it sees nothing."""
        distance = self.probe(camera)
        seen = distance[np.isfinite(distance)]
        return float(np.median(seen)) if len(seen) else np.inf


def _as_rays(*parts: Array) -> list[NDArray[np.float32]]:
    return [np.ascontiguousarray(part, dtype=np.float32) for part in parts]


def _mitsuba_rays(origins: Array, directions: Array) -> mi.Ray3f:
    start, way = _as_rays(origins.T, directions.T)
    return mi.Ray3f(mi.Point3f(start), mi.Vector3f(way))


def _infinite_where_missed(found: Array) -> Array:
    distance = np.asarray(found, dtype=np.float64)
    # Embree marks a miss with the largest distance it was given.
    return np.where(distance >= 1e30, np.inf, distance)
