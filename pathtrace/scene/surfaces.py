"""The scene's surfaces in an Embree tree: free space, and what is visible from a point."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from compose.camera.camera import Camera
from pathtrace.scene.tessellation import triangles_of

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
        distance = np.asarray(found, dtype=np.float64)
        # Embree marks a miss with the largest distance it was given.
        return np.where(distance >= 1e30, np.inf, distance)

    def clearance(self, point: Array) -> float:
        """Distance from a point (3,) to the nearest surface, over a fixed set of directions."""
        directions = sphere_directions(_CLEARANCE_DIRECTIONS)
        return float(self.distance(np.repeat(point[None], len(directions), axis=0), directions).min())

    def sees(self, start: Array, end: Array) -> bool:
        """Whether no surface lies on the straight line between two points (3,)."""
        way = end - start
        length = float(np.linalg.norm(way))
        return length == 0 or float(self.distance(start[None], way[None] / length)[0]) > length

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


def sphere_directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere: a Fibonacci lattice."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    turn = index * np.pi * (1 + 5**0.5)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
