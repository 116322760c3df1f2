"""Scenes and regions that the tests of this room share."""

from __future__ import annotations

import pytest

from pathtrace.region import view_selection as selection
from pathtrace.region.reachable import ReachableRegion
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.scene.triangles import Surfaces
from tests.pathtrace.region import boxes


@pytest.fixture(scope="package", autouse=True)
def coarse():
    """Fewer viewers and candidates, each with fewer pixels: enough for two empty rooms."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "_VIEWERS", 160)
        patch.setattr(selection, "_CANDIDATES", 128)
        patch.setattr(selection, "_ROUND", 64)
        patch.setattr(selection, "_SIDE", 12)
        yield


@pytest.fixture(scope="session")
def joined(backend) -> tuple[Scene, Surfaces]:
    """Two rooms with a door between them."""
    scene = load_scene(boxes.rooms(1.2))
    return scene, scene.surfaces()


@pytest.fixture(scope="session")
def reachable(joined) -> ReachableRegion:
    return ReachableRegion(*joined)
