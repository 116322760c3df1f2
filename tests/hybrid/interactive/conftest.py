"""A source of real frames, and frames made up."""

from __future__ import annotations

import pytest

from hybrid.frame.live import LiveRenderer
from hybrid.interactive.source import FrameSource
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest


@pytest.fixture(scope="session")
def source(backend, made) -> FrameSource:
    """Frames of the Cornell box."""
    return FrameSource(LiveRenderer(load_scene("cornell"), load_forest(made / "box.forest")))
