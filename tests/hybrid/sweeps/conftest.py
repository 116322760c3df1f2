"""A tiny scene with a rough forest, and what a row starts from."""

from __future__ import annotations

import pytest

from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import SWEEP
from hybrid.sweeps.setting import Setting
from pathtrace.scene.scene import Scene, load_scene
from splat.model.forest import Forest
from tests import small
from tests.hybrid.forests import rough_forest


@pytest.fixture(scope="session")
def corner(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="session")
def rough(corner) -> Forest:
    return rough_forest(corner)


@pytest.fixture
def renderer(corner, rough) -> Renderer:
    return Renderer(corner, rough)


@pytest.fixture
def base(corner) -> Setting:
    """The setting that sweeps vary."""
    return Setting(corner.camera.resized(48, 32), SWEEP)
