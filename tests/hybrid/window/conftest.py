"""A source of real frames."""

from __future__ import annotations

import pytest

from hybrid.preparation.scene_plan import planned_scene
from hybrid.render.frame_renderer import LiveRenderer
from hybrid.window.frame_source import FrameSource
from splat.io.forest_file import load_forest


@pytest.fixture(scope="session")
def renderer(backend, made) -> LiveRenderer:
    """Renders the Cornell box."""
    return LiveRenderer(planned_scene("cornell"), load_forest(made / "box.forest"))


@pytest.fixture
def source(renderer) -> FrameSource:
    """Frames of the Cornell box, none of which has been shown."""
    renderer.forget()
    return FrameSource(renderer)
