"""Regions: where a viewer may be, which views to train on there, and which to validate with."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera
from pathtrace.region.camera_path import PathRegion
from pathtrace.region.neighbourhood import NearRegion
from pathtrace.region.reachable import ReachableRegion
from pathtrace.scene.scene import Scene
from pathtrace.scene.triangles import Surfaces

NEAR, REACHABLE = "near", "reachable"


class ViewingRegion(Protocol):
    """A part of a scene's free space. Points and cameras are in the scene's coordinates."""

    @property
    def name(self) -> str:
        """What users call it: near, reachable, or the name of a file."""

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """(N,) whether a viewer can be at points (N, 3)."""

    def identity(self) -> dict[str, Any]:
        """What tells it from other regions of the same scene, as JSON."""

    def views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Views to train on, of a size in pixels; UserError if there is no free space for them.

        The first of them are the same whatever their number; same seed, same views.
        """

    def unseen_views(self, count: int, width: int, height: int, seed: int) -> list[Camera]:
        """Held-out validation views, drawn apart from those to train on; otherwise as `views`."""


def region_of(scene: Scene, surfaces: Surfaces, given: str) -> ViewingRegion:
    """The region that a user asks for.

    That is "near" for a ball around the scene's own camera, "reachable" for all that a viewer can reach from
    there, or the name of a file with a camera's path (pathtrace.region.camera_path). UserError if there is no
    such region or file, the file is broken, the path leaves the free space, the scene's own camera sees
    nothing, or there is no free space around it.
    """
    if given == NEAR:
        return NearRegion(scene, surfaces)
    if given == REACHABLE:
        return ReachableRegion(scene, surfaces)
    file = Path(given)
    if not file.suffix and not file.exists():
        raise UserError(f"region {given!r}: must be {NEAR}, {REACHABLE} or the file of a camera's path")
    return PathRegion(scene, surfaces, file)
