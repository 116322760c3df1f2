"""A frame set of a small scene and a forest trained on it."""

from __future__ import annotations

import pytest

from hybrid.preparation.forest_training import train
from pathtrace.dataset.capture import capture
from pathtrace.dataset.frame_set import CaptureSettings, FrameSet
from pathtrace.scene.scene import load_scene
from splat.model.forest import Forest
from splat.training.trainer import TrainingSettings
from tests import small


def ignore(done: int, total: int) -> None:
    """Ignores progress."""


@pytest.fixture(scope="session")
def training_settings() -> TrainingSettings:
    return TrainingSettings(iterations=20, gaussians=300, layers=2, degree=1)


@pytest.fixture(scope="session")
def frames(backend, tmp_path_factory) -> FrameSet:
    """Three training views and a held-out one."""
    settings = CaptureSettings(views=3, held_out=1, width=24, height=24, spp=2, held_out_spp=4)
    return capture(load_scene(small.corner()), tmp_path_factory.mktemp("frames"), settings, ignore)


@pytest.fixture(scope="session")
def trained(frames, training_settings, tmp_path_factory) -> Forest:
    """A forest that was trained without an interruption."""
    return train(frames, tmp_path_factory.mktemp("trained") / "f", training_settings)
