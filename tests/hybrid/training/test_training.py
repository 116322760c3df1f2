"""Training from a frame set: checkpoints on interruption, and what they refuse."""

from __future__ import annotations

import signal
from dataclasses import replace

import pytest
import torch

from compose.base.errors import UserError
from hybrid.training.forest import checkpoint_path, held_out_quality, train_forest
from pathtrace.dataset.capture import capture
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest
from splat.io.tensors import save_tensors
from splat.training.trainer import TrainingSettings
from tests import small

SETTINGS = TrainingSettings(iterations=40, gaussians=300, layers=2, degree=1)


def ignore(done: int, total: int) -> None:
    pass


@pytest.fixture(scope="module")
def frames(backend, tmp_path_factory):
    settings = CaptureSettings(views=3, held_out=1, width=24, height=24, spp=2, held_out_spp=4)
    return capture(load_scene(small.corner()), tmp_path_factory.mktemp("frames"), settings, ignore)


def test_ctrl_c_leaves_a_checkpoint_and_the_next_run_ends_the_same(arrays, frames, tmp_path):
    whole, _ = train_forest(arrays, frames, tmp_path / "whole", SETTINGS, ignore)

    def interrupt(done: int, total: int) -> None:
        if done == 17:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train_forest(arrays, frames, tmp_path / "parts", SETTINGS, interrupt)
    assert not (tmp_path / "parts").exists()
    assert checkpoint_path(tmp_path / "parts").exists()
    steps = []
    train_forest(arrays, frames, tmp_path / "parts", SETTINGS, lambda done, total: steps.append(done))
    assert steps[0] == 18
    assert not checkpoint_path(tmp_path / "parts").exists()
    parts = load_forest(tmp_path / "parts")
    for (_, a), (_, b) in zip(whole.nodes.gaussians.tensors(), parts.nodes.gaussians.tensors(), strict=True):
        assert torch.equal(a, b)


def test_a_checkpoint_of_something_else_is_refused(arrays, frames, tmp_path):
    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_forest(arrays, frames, tmp_path / "f", SETTINGS, interrupt)
    other = replace(SETTINGS, iterations=41)
    with pytest.raises(UserError, match="other settings; remove it"):
        train_forest(arrays, frames, tmp_path / "f", other, ignore)
    save_tensors(checkpoint_path(tmp_path / "f"), {"a": torch.zeros(1)}, {"kind": "checkpoint"})
    with pytest.raises(UserError, match="not a checkpoint of this training"):
        train_forest(arrays, frames, tmp_path / "f", SETTINGS, ignore)


def test_frames_too_small_for_the_loss_are_refused(arrays, tmp_path):
    settings = CaptureSettings(views=2, held_out=0, width=16, height=8, spp=1)
    small_frames = capture(load_scene(small.corner()), tmp_path / "frames", settings, ignore)
    with pytest.raises(UserError, match="16 x 8 pixels are too small"):
        train_forest(arrays, small_frames, tmp_path / "f", SETTINGS, ignore)


def test_quality_is_of_the_held_out_views(arrays, frames, tmp_path):
    forest, _ = train_forest(arrays, frames, tmp_path / "f", SETTINGS, ignore)
    measured = held_out_quality(arrays, frames, forest)
    assert [row["layer"] for row in measured] == [1, 2]
    assert [row["nodes"] for row in measured] == list(forest.counts)
    # Two samples per pixel and forty steps: rough, but the picture of this scene and no other.
    assert min(row["psnr"] for row in measured) > 12
