"""Training on a frame set: what views show, what an interruption leaves, and what is refused."""

from __future__ import annotations

import math
import signal
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from hybrid.preparation import forest_training as module
from hybrid.preparation.forest_errors import with_errors
from hybrid.preparation.forest_training import checkpoint_path, train
from hybrid.preparation.training_views import training_view
from pathtrace.dataset.capture import capture
from pathtrace.dataset.captured_frames import read_frame
from pathtrace.dataset.frame_set import CaptureSettings
from pathtrace.scene.scene import load_scene
from splat.io.compact import compact, exactly_encoded
from splat.io.forest_file import load_forest
from splat.model.choices import Precision
from splat.training.trainer import TrainingSettings
from tests import small
from tests.hybrid.preparation.conftest import ignore


def test_a_training_view_is_the_captured_frame(frames):
    entry = frames.training[0]
    view, frame = training_view(entry), read_frame(entry.file)
    assert view.camera == entry.camera
    np.testing.assert_array_equal(view.radiance, frame.radiance)
    np.testing.assert_array_equal(view.distance, frame.unfolded)


def test_what_is_seen_in_a_flat_mirror_has_no_normal(backend, tmp_path):
    """Everything else keeps its normal, and what a ball shows lies on the ball."""
    mirror = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, -0.5, 0.5]).rotate([1, 0, 0], -90),
        "bsdf": {"type": "conductor"},
    }
    scene = load_scene({**small.corner(), "mirror": mirror})
    settings = CaptureSettings(views=2, held_out=0, width=24, height=24, spp=1)
    shown = set()
    for entry in capture(scene, tmp_path, settings, ignore).training:
        view, frame = training_view(entry), read_frame(entry.file)
        unknown = (view.normal == 0).all(axis=2)
        np.testing.assert_array_equal(view.normal[~unknown], frame.normal[~unknown])
        shown |= set(frame.shape[unknown & (frame.normal != 0).any(axis=2)].tolist())
    (index,) = shown
    np.testing.assert_allclose(
        np.ravel(scene.mitsuba.shapes()[index].bbox().center()), [0, -0.5, 0.5], atol=1e-5
    )


def test_a_forest_belongs_to_the_scene_of_its_frames(frames, trained, training_settings):
    assert (trained.scene_name, trained.scene_hash) == (frames.scene_name, frames.scene_hash)
    assert trained.trained_focal == frames.training[0].camera.fy
    assert len(trained.counts) == training_settings.layers


def test_numbers_are_rounded_unless_exact_ones_are_asked_for(frames, trained, training_settings, tmp_path):
    """What is returned is what the file holds."""
    assert exactly_encoded(trained) is not None
    exact = train(frames, tmp_path / "f", training_settings, precision=Precision.FLOAT32)
    assert exactly_encoded(exact) is None
    assert load_forest(tmp_path / "f").digest() == exact.digest()
    assert compact(exact).digest() == replace(trained, attached=exact.attached).digest()


def test_ctrl_c_leaves_a_checkpoint_and_the_next_run_ends_the_same(
    frames, trained, training_settings, tmp_path
):
    def interrupt(done: int, total: int) -> None:
        assert total == 20
        if done == 9:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(frames, tmp_path / "parts", training_settings, interrupt)
    assert [path.name for path in tmp_path.iterdir()] == [checkpoint_path(tmp_path / "parts").name]
    steps = []
    returned = train(frames, tmp_path / "parts", training_settings, lambda done, total: steps.append(done))
    assert steps == list(range(10, 21))
    assert [path.name for path in tmp_path.iterdir()] == ["parts"]
    for parts in (returned, load_forest(tmp_path / "parts")):
        pairs = zip(trained.nodes.gaussians.tensors(), parts.nodes.gaussians.tensors(), strict=True)
        for (_, expected), (_, found) in pairs:
            assert torch.equal(found, expected)


def test_the_first_steps_tell_how_many_there_will_be(frames, training_settings, tmp_path):
    """It holds after an interruption."""
    settings, asked, told = replace(training_settings, iterations=60), [], []

    def paced(seconds: float, done: int, fewest: int) -> int:
        assert 0 < seconds < 60
        assert fewest == math.ceil(done / 0.7)
        asked.append(done)
        return {8: 50, 16: 45, 22: 44}[done]

    def interrupt(done: int, total: int) -> None:
        told.append(total)
        if done in (12, 30):
            signal.raise_signal(signal.SIGINT)

    whole = train(frames, tmp_path / "whole", settings, paced=paced)
    assert asked == [8, 16, 22]
    for known in (60, 50):
        resumed = replace(settings, iterations=known)
        with pytest.raises(KeyboardInterrupt):
            train(frames, tmp_path / "parts", resumed, interrupt, paced=paced)
    assert asked == [8, 16, 22] * 2
    assert told == [60] * 8 + [50] * 8 + [45] * 6 + [44] * 8
    parts = train(frames, tmp_path / "parts", replace(settings, iterations=44))
    # What a stage does not learn yet.
    assert parts.digest() == with_errors(frames, whole).digest()
    # The others are over before anybody could tell.
    train(frames, tmp_path / "short", training_settings, paced=paced)
    assert asked == [8, 16, 22] * 2


def test_a_checkpoint_is_saved_every_thirty_seconds(frames, training_settings, tmp_path, monkeypatch):
    now, saved = [0.0], []

    def saving(trainer, path, frames) -> None:
        assert path == checkpoint_path(tmp_path / "f")
        saved.append(trainer.iteration)

    def advance(done: int, total: int) -> None:
        now[0] += 11.0

    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(module, "save_checkpoint", saving)
    settings = replace(training_settings, iterations=7, layers=1)
    train(frames, tmp_path / "f", settings, advance)
    assert saved == [3, 6]


def test_a_forest_that_is_not_finite_is_not_written(frames, training_settings, tmp_path, monkeypatch):
    def broken(*arguments: object):
        forest = original(*arguments)
        forest.nodes.gaussians.means[0, 0] = float("nan")
        return forest

    original = module.forest_of
    monkeypatch.setattr(module, "forest_of", broken)
    with pytest.raises(RuntimeError, match="not finite"):
        train(frames, tmp_path / "f", replace(training_settings, iterations=1, layers=1))
    assert not (tmp_path / "f").exists()


def test_frames_too_small_for_the_layers_are_refused(frames, backend, tmp_path):
    settings = CaptureSettings(views=2, held_out=0, width=16, height=8, spp=1)
    tiny = capture(load_scene(small.corner()), tmp_path / "frames", settings, ignore)
    message = r"frames: frames of 16 x 8 pixels are too small for 2 layers; they allow 0, or capture larger"
    with pytest.raises(UserError, match=message):
        train(tiny, tmp_path / "f", TrainingSettings(layers=2))
    with pytest.raises(UserError, match="24 x 24 pixels are too small for 3 layers; they allow 2"):
        train(frames, tmp_path / "f", TrainingSettings(layers=3))


def test_a_frame_set_without_training_views_is_refused(frames, tmp_path):
    none = replace(frames, entries=frames.held_out)
    with pytest.raises(UserError, match=f"^{frames.folder}: holds no frames to train on$"):
        train(none, tmp_path / "f")
    assert not list(tmp_path.iterdir())
