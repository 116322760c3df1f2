"""Forests of scenes that move: from frames at many times to frames at any time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from hybrid.base.compute_device import device_arrays
from hybrid.preparation.forest_errors import held_out_quality
from hybrid.preparation.forest_training import motion_of, train
from hybrid.preparation.training_views import training_view
from hybrid.render import frame_renderer as renderer_module
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.irradiance import filled_cache
from pathtrace.dataset.captured_frames import read_frame
from pathtrace.dataset.frame_set import FrameSet, read_frame_set
from pathtrace.dataset.growing import GrowingFrames, Wanted
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from splat.io.forest_file import load_forest, save_forest
from splat.lod.forest_renderer import ForestRenderer
from splat.model.choices import MotionModel
from splat.model.forest import Forest
from splat.model.motion import LearnedMotion
from splat.training.trainer import TrainingSettings
from tests import small
from tests.hybrid.preparation.conftest import ignore
from tests.moving import DEGREES, WAY, moving_corner


@pytest.fixture(scope="module")
def scene(backend, tmp_path_factory) -> Scene:
    return moving_corner(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def frames(scene, tmp_path_factory) -> FrameSet:
    folder = tmp_path_factory.mktemp("frames")
    views = [Wanted(scene.camera.resized(32, 32), 2, time) for time in (0.0, 0.4, 0.7, 1.0)]
    GrowingFrames(folder, Tracer(scene), "path", 0).grow(views, ignore)
    return read_frame_set(folder)


@pytest.fixture(scope="module")
def forest(frames, tmp_path_factory) -> Forest:
    settings = TrainingSettings(iterations=80, gaussians=900, layers=2, degree=0)
    return train(frames, tmp_path_factory.mktemp("trained") / "f", settings)


def test_views_know_their_time_and_what_moves(frames):
    for entry, time in zip(frames.training, (0.0, 0.4, 0.7, 1.0), strict=True):
        view = training_view(entry, frames.courses)
        assert view.time == time
        assert view.instance is not None
        board = read_frame(entry.file).shape == frames.courses[0].shape
        np.testing.assert_array_equal(view.instance, np.where(board, 0, -1))
    assert training_view(frames.training[0]).instance is None


def test_the_motion_is_that_of_the_courses(frames):
    motion = motion_of(frames.courses)
    assert motion is not None
    np.testing.assert_allclose(motion.at(0.0).offsets, 0, atol=1e-12)
    np.testing.assert_allclose(motion.shifts[-1, 0], [WAY, 0, 0], atol=1e-9)
    np.testing.assert_allclose(motion.centres, [[-0.6, 0.1, 1.2]], atol=1e-9)
    half = np.radians(DEGREES / 2)
    np.testing.assert_allclose(
        motion.at(1.0).rotations[0].abs(), [np.cos(half), 0, 0, np.sin(half)], atol=1e-9
    )
    assert motion_of(()) is None


def test_a_forest_shows_the_board_where_it_is(frames, forest):
    """Nearer to each frame than at another time."""
    renderer = ForestRenderer(device_arrays(), forest)
    entries = frames.training
    errors = np.zeros((4, 4))
    for row, shown in enumerate(entries):
        renderer.set_time(shown.time)
        for column, entry in enumerate(entries):
            image = renderer.render_layer(entry.camera, len(forest.counts)).numpy()
            truth = read_frame(entry.file).radiance
            errors[row, column] = np.mean((np.clip(image, 0, 1) - np.clip(truth, 0, 1)) ** 2)
    assert (np.diag(errors) < 0.8 * np.where(np.eye(4) > 0, np.inf, errors).min(axis=0)).all()


def test_a_forest_that_moves_comes_back_from_its_file(forest, tmp_path):
    save_forest(tmp_path / "f", forest)
    back = load_forest(tmp_path / "f")
    assert back.motion is not None
    assert forest.motion is not None
    for name, tensor in forest.motion.tensors().items():
        torch.testing.assert_close(back.motion.tensors()[name], tensor, rtol=0, atol=0)
    assert back.digest() == forest.digest()
    assert replace(forest, motion=None).digest() != forest.digest()


@pytest.mark.parametrize(
    "change",
    [
        lambda motion: replace(motion, rotations=2 * motion.rotations),
        lambda motion: replace(motion, shifts=motion.shifts + torch.inf),
    ],
)
def test_a_damaged_motion_is_refused(forest, tmp_path, change):
    save_forest(tmp_path / "f", replace(forest, motion=change(forest.motion)))
    with pytest.raises(UserError, match=r"f: damaged forest file \(a motion"):
        load_forest(tmp_path / "f")


def test_held_out_frames_are_judged_at_their_times(frames, forest):
    entries = [replace(entry, held_out=True) for entry in frames.entries]
    right = held_out_quality(replace(frames, entries=entries), forest)[-1]["psnr"]
    wrong = held_out_quality(
        replace(frames, entries=[replace(entry, time=1 - entry.time) for entry in entries]), forest
    )[-1]["psnr"]
    assert right > wrong + 1


SETTINGS = FrameSettings(fov_a=30, fov_b=20, spp=2, fovea="raw", acuity_model="none", fill=False)


def test_disc_and_periphery_show_the_same_time(scene, forest):
    renderer = Renderer(scene, forest)
    seen = {}
    for time in (0.0, 0.7, 0.0, 0.7):
        frame = renderer.frame(replace(SETTINGS, time=time), 5)
        if time in seen:
            np.testing.assert_array_equal(frame.composite, seen[time])
        seen[time] = frame.composite
        alone = ForestRenderer(device_arrays(), forest)
        alone.set_time(time)
        whole = alone.render_layer(scene.camera, len(forest.counts)).numpy()
        np.testing.assert_allclose(frame.composite[0], whole[0], atol=1e-4)
        assert scene.moving is not None
        assert scene.moving.time == time
        np.testing.assert_array_equal(
            renderer.depth(scene.camera),
            Renderer(scene, forest).depth(scene.camera),
        )
    assert np.abs(seen[0.0] - seen[0.7]).max() > 0.1


def test_a_scene_that_stands_still_has_no_other_time(forest, frames):
    still = load_scene(small.corner())
    renderer = Renderer(still, replace(forest, scene_hash=still.hash))
    with pytest.raises(UserError, match=r"^time 0\.5: nothing moves in dictionary$"):
        renderer.frame(replace(SETTINGS, time=0.5))


def test_times_of_two_renderers_of_a_scene_do_not_mix(scene, forest):
    """The scene is shared: each frame shows its own time."""
    one, other = Renderer(scene, forest), Renderer(scene, forest)
    early, late = replace(SETTINGS, time=0.1), replace(SETTINGS, time=0.9)
    first = one.frame(early, 1).composite
    second = other.frame(late, 1).composite
    np.testing.assert_array_equal(one.frame(early, 1).composite, first)
    np.testing.assert_array_equal(other.frame(late, 1).composite, second)


def test_hits_follow_the_time(scene):
    camera, tracer = scene.camera, Tracer(scene)
    found = []
    for time in (0.0, 1.0, 0.0):
        scene.set_time(time)
        found.append(tracer.hits(camera, frame_positions(camera)).distance)
    np.testing.assert_array_equal(found[0], found[2])
    assert np.mean(found[0] != found[1]) > 0.02


def test_splats_alone_need_no_cache(scene, forest, monkeypatch):
    """Nor do they leave the scene at another time."""
    monkeypatch.setattr(renderer_module, "cache_for", None)
    Renderer(scene, forest).splats(replace(SETTINGS, fovea="fused", time=0.4))
    assert scene.moving is not None
    assert scene.moving.time == 0.4


def test_a_disc_alone_shows_its_time_though_the_cache_is_filled_for_it(scene, forest, monkeypatch):
    monkeypatch.setattr(renderer_module, "cache_for", filled_cache)
    settings = replace(SETTINGS, integrator="cached", time=0.7)
    expected = Renderer(scene, forest).frame(settings, 5).fovea.radiance
    found = Renderer(scene, forest).disc_alone(settings, 5).radiance
    np.testing.assert_array_equal(np.stack(found), np.stack(expected))


def test_a_motion_that_is_learned_is_part_of_the_forest(frames, tmp_path):
    """Whatever the frames know of it; all Gaussians are dynamic, and move."""
    settings = TrainingSettings(
        iterations=60, gaussians=400, layers=2, degree=0, motion=MotionModel.HEX_PLANE
    )
    trained = train(frames, tmp_path / "f", settings)
    back = load_forest(tmp_path / "f")
    assert isinstance(back.motion, LearnedMotion)
    assert back.digest() == trained.digest()
    assert bool(back.nodes.dynamic.all())
    none = back.nodes.semantic
    before, after = (back.motion.shown(back.nodes.gaussians, none, time).means for time in (0.0, 1.0))
    assert float((after - before).abs().max()) > 0
