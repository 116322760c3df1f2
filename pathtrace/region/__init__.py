"""Regions: where a viewer may be, which views to train on there, and which to validate with."""

from __future__ import annotations

from pathlib import Path

from compose.base.errors import UserError
from pathtrace.region.camera_path import PathRegion
from pathtrace.region.neighbourhood import NearRegion
from pathtrace.region.reachable import ReachableRegion
from pathtrace.scene.scene import Scene
from pathtrace.scene.triangles import Surfaces

NEAR, REACHABLE = "near", "reachable"
# A part of a scene's free space; points and cameras are in the scene's coordinates. Its name is what users
# call it: near, reachable, or the name of a file. Its identity is JSON. Views have a size in pixels, and the
# same seed gives the same ones; the first of those to train on are the same whatever their number. Those for
# validation are drawn apart from them. Without free space for views, there is a UserError.
ViewingRegion = NearRegion | ReachableRegion | PathRegion


def region_of(scene: Scene, surfaces: Surfaces, given: str) -> ViewingRegion:
    """The region that a user asks for: "near", "reachable", or the name of a file with a camera's path.

    UserError if there is no such region or file, the file is broken, the path leaves the free space, the
    scene's own camera sees nothing, or there is no free space around it.
    """
    if given == NEAR:
        return NearRegion(scene, surfaces)
    if given == REACHABLE:
        return ReachableRegion(scene, surfaces)
    file = Path(given)
    if not file.suffix and not file.exists():
        raise UserError(f"region {given!r}: must be {NEAR}, {REACHABLE} or the file of a camera's path")
    return PathRegion(scene, surfaces, file)
