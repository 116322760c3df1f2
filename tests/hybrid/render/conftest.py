"""A scene and a rough forest of it, for all tests of frames."""

from __future__ import annotations

import pytest

from hybrid.render.frame_renderer import Renderer
from pathtrace.scene.scene import Scene, load_scene
from splat.model.forest import Forest
from tests import small
from tests.hybrid.forests import rough_forest


@pytest.fixture(scope="session")
def scene(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="session")
def forest(scene) -> Forest:
    return rough_forest(scene)


@pytest.fixture(scope="session")
def renderer(scene, forest) -> Renderer:
    """Without a history, and thus without any state that frames could share."""
    return Renderer(scene, forest)
