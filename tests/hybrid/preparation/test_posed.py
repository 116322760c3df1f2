"""Training on frames of others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.image.colour import srgb_from_radiance
from hybrid.preparation.forest_errors import held_out_quality
from hybrid.preparation.forest_training import checkpoint_path, train
from hybrid.preparation.training_views import labelled_views, motion_for, read_frames
from hybrid.render.forest_attachments import views_of
from pathtrace.dataset.frame_set import FrameSet
from pathtrace.dataset.posed_images import read_pixels
from splat.io.forest_file import load_forest
from splat.model.choices import Labels, MotionModel
from splat.model.motion import LearnedMotion
from splat.training.trainer import TrainingSettings
from tests import posed
from tests.hybrid.preparation.conftest import ignore

pytestmark = pytest.mark.usefixtures("backend")
SETTINGS = TrainingSettings(iterations=80, gaussians=900, layers=2, degree=0)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A folder in each layout, by name."""
    at = tmp_path_factory.mktemp("posed")
    return {
        "still": posed.write_synthetic(at / "still", training=18, held_out=2, moving=False),
        "d-nerf": posed.write_synthetic(at / "d-nerf", training=18, held_out=2),
        "nerfies": posed.write_nerfies(at / "nerfies", training=18, held_out=2),
        "nerf-ds": posed.write_nerfies(at / "nerf-ds", training=18, held_out=2, labels=".png.png"),
        "no points": posed.write_nerfies(at / "no-points", training=18, held_out=2, points=False),
    }


@pytest.mark.parametrize(
    ("layout", "motion"),
    [
        ("still", MotionModel.KNOWN),
        ("d-nerf", MotionModel.HEX_PLANE),
        ("nerf-ds", MotionModel.D_GS_OF_DYNAMIC),
        ("no points", MotionModel.HEX_PLANE),
    ],
)
def test_each_layout_is_learned(folders, tmp_path, layout, motion):
    frames = read_frames(folders[layout])
    assert motion_for(frames, None) is (MotionModel.KNOWN if layout == "still" else MotionModel.HEX_PLANE)
    forest = train(frames, tmp_path / "f", replace(SETTINGS, motion=motion), report=lambda _: None)
    stored = load_forest(tmp_path / "f")
    assert (stored.scene_name, stored.scene_hash) == (frames.scene_name, frames.scene_hash)
    assert isinstance(forest.motion, LearnedMotion) == (layout != "still")
    assert len(views_of(stored)) == 18
    if motion is MotionModel.D_GS_OF_DYNAMIC:
        assert 0 < int(stored.nodes.dynamic.sum()) < len(stored.nodes)
    rows = held_out_quality(frames, stored)
    assert rows[-1]["psnr"] > _of_a_constant(frames) + 3


def _of_a_constant(frames) -> float:
    """Mean PSNR in dB of frames in one colour, that which is best for each held-out view."""
    found = []
    for image in frames.held_out:
        seen = srgb_from_radiance(read_pixels(image).radiance)
        found.append(-10 * np.log10(np.mean((seen - seen.mean(axis=(0, 1))) ** 2)))
    return float(np.mean(found))


def test_distances_are_those_of_the_hull_and_of_points(folders):
    for layout, tolerance in (("still", 0.1), ("nerfies", 0.3)):
        frames = read_frames(folders[layout])
        for image, view in zip(frames.training, labelled_views(frames, SETTINGS), strict=True):
            exact, ball, _ = posed.cast(view.camera, image.time)
            if layout == "still":
                assert np.array_equal(np.isinf(view.distance), ~ball)
            shown = np.isfinite(view.distance)
            assert np.median(np.abs(view.distance - exact)[shown]) < tolerance


def test_an_interrupted_training_ends_as_one_that_was_not(folders, tmp_path):
    frames = read_frames(folders["nerfies"])
    settings = replace(SETTINGS, iterations=20, motion=MotionModel.HEX_PLANE)
    whole = train(frames, tmp_path / "whole", settings, report=lambda _: None)

    def interrupt(done: int, total: int) -> None:
        if done == 12:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(frames, tmp_path / "f", settings, interrupt)
    assert checkpoint_path(tmp_path / "f").is_file()
    again = train(frames, tmp_path / "f", settings, ignore, report=lambda _: None)
    for name, tensor in whole.nodes.gaussians.tensors():
        assert torch.equal(tensor, dict(again.nodes.gaussians.tensors())[name])


def test_a_motion_that_frames_do_not_know_is_refused(folders, tmp_path):
    with pytest.raises(UserError, match=r"motion known: .* does not say how anything moves"):
        train(read_frames(folders["d-nerf"]), tmp_path / "f", SETTINGS)
    with pytest.raises(UserError, match=r"labels masks: .* has no label images"):
        motion_for(read_frames(folders["nerfies"]), MotionModel.D_GS_OF_DYNAMIC, Labels.MASKS)
    with pytest.raises(UserError, match="all frames show the same time"):
        train(read_frames(folders["still"]), tmp_path / "f", replace(SETTINGS, motion=MotionModel.D_GS))
    assert not (tmp_path / "f").exists()


def test_without_label_images_flow_tells_what_moves(folders):
    settings = replace(SETTINGS, motion=MotionModel.D_GS_OF_DYNAMIC)
    for name, labelled in (("nerfies", False), ("nerf-ds", True)):
        frames = read_frames(folders[name])
        assert all((image.labels is not None) == labelled for image in frames.training)
        views = labelled_views(frames, settings)
        assert all(view.instance is not None for view in views)
        flow = labelled_views(frames, replace(settings, labels=Labels.FLOW))
        same = all(np.array_equal(a.instance, b.instance) for a, b in zip(views, flow, strict=True))
        assert same != labelled


def test_a_frame_set_is_read_as_one(frames, tmp_path):
    assert isinstance(read_frames(frames.folder), FrameSet)
    with pytest.raises(UserError, match=r"not a frame set .* nor third-party frames"):
        read_frames(tmp_path)
    (tmp_path / "transforms.json").write_text("{")
    with pytest.raises(UserError, match=r"transforms\.json: not the description of a frame set"):
        read_frames(tmp_path)
