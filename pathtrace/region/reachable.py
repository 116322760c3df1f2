"""All of the space that a viewer can reach from the scene's own camera, looking anywhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera
from pathtrace.region.drawing import JUDGING, TRAINING, VIEWING, drawn, generator
from pathtrace.region.free_space import FreeSpace, Measures
from pathtrace.region.looks import Looks, turned_about, upright, widened
from pathtrace.region.selection import Selection
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces

# Steepest looks in degrees: of viewers, and of views to train on, which may show floor and ceiling as well.
_PITCH, _TRAINING_PITCH = 30.0, 45.0
# Least field of view of the views to train on, in degrees. Wider views than those of viewers show a little
# more, and all of it coarser: 100 views of 36, 60 and 75 degrees cover 74, 69 and 68 % of what viewers with
# 36 degrees see at half of their resolution.
_FIELD_OF_VIEW = 40.0
# Surfaces nearer than this many radii of a viewer are too near to look at.
_NEAR = 2.0
# Side of a patch of surface whose views are counted, in units of the space's size.
_PATCH = 0.12


class ReachableRegion:
    """The reachable space of a scene.

    Args:
        scene: the scene.
        surfaces: its surfaces.

    Attributes:
        name: "reachable".
        space: the lattice of what can be reached.

    Raises:
        UserError: the scene's own camera sees no surface, or a viewer has no space there.
    """

    name = "reachable"

    def __init__(self, scene: Scene, surfaces: Surfaces):
        self._scene, self._surfaces = scene, surfaces
        measures = Measures.of(surfaces, scene.camera)
        if measures is None:
            raise UserError(f"{scene.name}: the scene's own camera sees no surface")
        self._measures = measures
        self.space = FreeSpace(surfaces, scene.camera, measures)
        if not len(self.space.nodes):
            unit = scene.place.unit
            raise UserError(
                f"{scene.name}: no free space around the scene's own camera for a viewer with a radius of "
                f"{self.space.radius * unit:.3g}; the nearest surface is "
                f"{surfaces.clearance(scene.camera.position) * unit:.3g} away"
            )
        self._up = upright(scene.camera)

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """(N,) whether a viewer can be at points (N, 3)."""
        return self.space.contains(points)

    def identity(self) -> dict[str, Any]:
        """What tells it from other regions of the same scene."""
        return {"kind": "reachable"}

    def views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Views to train on: the scene's own camera, then those that show most of what is new."""
        home = self._scene.camera.resized(width, height)
        wide = widened(home, _FIELD_OF_VIEW)
        viewers = self._draw(Selection.viewers(), home, _PITCH, generator(0, VIEWING))
        patch = _PATCH * self._measures.size
        selection = Selection(self._surfaces, patch, home.position, (viewers, home))

        def candidates(number: int, round_index: int) -> Looks:
            return self._draw(number, wide, _TRAINING_PITCH, generator(seed, TRAINING, round_index))

        return selection.chosen(count, [home], wide, candidates)

    def unseen_views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Views to judge by: anywhere in the space, level on average."""
        home = self._scene.camera.resized(width, height)
        looks = self._draw(count, home, _PITCH, generator(seed, JUDGING))
        if len(looks) < count:
            raise UserError(f"{self._scene.name}: only {len(looks)} of {count} views of it show surfaces")
        return [looks.camera(index, home) for index in range(count)]

    def _draw(self, count: int, like: Camera, pitch: float, rng: np.random.Generator) -> Looks:
        def propose(number: int) -> Looks:
            positions = self.space.sample(number, rng)
            yaw, up = 360 * rng.random(number), pitch * (2 * rng.random(number) - 1)
            return Looks(positions, turned_about(self._up, yaw, up))

        found = drawn(count, propose, self._surfaces, like, _NEAR * self.space.radius)
        if not len(found):
            raise UserError(
                f"{self._scene.name}: nothing can be seen from the space around the scene's own camera"
            )
        return found
