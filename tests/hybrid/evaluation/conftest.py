"""A tiny scene with a rough forest, and what a row starts from."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.evaluation.sweep_catalogue import Setting
from hybrid.measure import frame_quality as quality
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import SWEEP
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
def quick_metrics(monkeypatch) -> None:
    """The two metrics that take longest are exchanged: JOD for one that is cheap, HDR-FLIP for none."""

    def cheap(image: np.ndarray, reference: np.ndarray, *_: object) -> float:
        return float(10 - np.abs(image - reference).mean())

    monkeypatch.setattr(quality, "jod", cheap)
    monkeypatch.setattr(quality, "hdr_flip_map", lambda *_: None)


@pytest.fixture
def base(corner) -> Setting:
    """The setting that sweeps vary."""
    return Setting(corner.camera.resized(48, 32), SWEEP)
