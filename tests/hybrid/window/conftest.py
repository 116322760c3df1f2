"""A source of real frames."""

from __future__ import annotations

import pytest

from hybrid.preparation.scene_plan import as_planned
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.window.frame_source import FrameSource
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest


@pytest.fixture(scope="session")
def renderer(backend, made) -> LiveRenderer:
    """Renders the Cornell box."""
    return LiveRenderer(as_planned(load_scene("cornell")), load_forest(made / "box.forest"))


@pytest.fixture
def source(renderer) -> FrameSource:
    """Frames of the Cornell box, none of which has been shown."""
    renderer.forget()
    return FrameSource(renderer)
