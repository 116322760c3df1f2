"""A source of real frames."""

from __future__ import annotations

import pytest

from hybrid.frame.live import LiveRenderer
from hybrid.interactive.source import FrameSource
from hybrid.plan.stored import planned_scene
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
