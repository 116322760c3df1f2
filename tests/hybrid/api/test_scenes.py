"""Loading and making scenes, frame sets and forests in Python."""

from __future__ import annotations

import pytest

import hybrid
from hybrid.api import workflow as scenes
from hybrid.preparation import scene_plan
from splat.io.forest_file import load_forest
from tests import moving, small
from tests.hybrid.preparation.tiny import make_tiny

CAPTURE = {"views": 2, "held_out": 1, "width": 24, "height": 24, "spp": 2, "held_out_spp": 4}
TRAINING = {"iterations": 2, "gaussians": 200, "layers": 1, "degree": 0}


def test_a_scene_may_be_a_name_or_a_dictionary(backend):
    bundled = scenes.load_scene("cornell")
    assert bundled.name == "cornell"
    assert scenes.load_scene(small.corner()).camera.width == 32


def test_another_path_depth_makes_another_scene(backend):
    usual, shallow = scenes.load_scene("cornell"), scenes.load_scene("cornell", max_depth=2)
    assert shallow.max_depth == hybrid.plan(shallow).max_depth == 2
    assert shallow.hash not in (usual.hash, hybrid.plan(usual).hash)


def test_a_motion_file_may_be_elsewhere(backend, tmp_path):
    file = moving.write_motion(tmp_path)
    still, moves = (scenes.load_scene(small.corner(), motion=motion) for motion in (None, file))
    assert still.moving is None
    assert moves.moving is not None
    assert moves.hash != still.hash


def test_scenes_that_cannot_be_loaded_are_user_errors(backend, tmp_path):
    with pytest.raises(hybrid.UserError, match="nowhere"):
        scenes.load_scene("nowhere.xml")
    with pytest.raises(hybrid.UserError, match="backend metal: must be auto, cuda or llvm"):
        scenes.load_scene("cornell", backend="metal")


def test_loading_renders_nothing_and_planning_stores(backend, own_home, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(scene_plan, "look_at_scene", lambda *arguments: pytest.fail("looked at"))
        fresh = scenes.load_scene("cornell")
    assert (fresh.plan, fresh.hash, fresh.max_depth) == ({}, fresh.own_hash, fresh.own_depth)
    planned = hybrid.plan(fresh)
    assert {"path depth", "gaussians", "degree"} <= {*planned.plan}
    monkeypatch.setattr(scene_plan, "plan_of", lambda *arguments, **options: pytest.fail("planned again"))
    again = scenes.load_scene("cornell")
    assert (again.plan, again.hash) == (planned.plan, planned.hash)
    assert hybrid.plan(again) is again
    assert hybrid.plan(fresh).hash == planned.hash


def test_a_scene_is_planned_and_prepared_in_one_call(backend, own_home, monkeypatch, tmp_path, caplog):
    make_tiny(monkeypatch.setattr)
    caplog.set_level("INFO", "hybrid")
    scene, labels = scenes.load_scene("cornell"), set()
    settings = hybrid.PreparationSettings(quality="draft", held_out=0)
    forest = scenes.prepare(
        scene, settings, tmp_path / "a.forest", progress=lambda done, total, label: labels.add(label)
    )
    assert load_forest(tmp_path / "a.forest").digest() == forest.digest()
    planned = scenes.load_scene("cornell")
    assert forest.scene_hash == planned.hash != scene.hash
    assert caplog.messages[0] == "No plan for scene cornell yet: looking at it first."
    assert {"stage 1: frames (samples)", "stage 2: forest (steps)"} <= labels
    # The scene that was loaded before has no plan, and the forest fits it all the same.
    rendered = hybrid.Renderer(scene, forest).scene
    assert (rendered.hash, rendered.plan["degree"]) == (planned.hash, planned.plan["degree"])


def test_a_forest_fits_a_scene_where_nothing_is_planned(made, backend, own_home):
    forest = load_forest(made / "box.forest")
    scene = scenes.load_scene("cornell")
    assert not scene.plan
    assert hybrid.Renderer(scene, forest).scene.hash == forest.scene_hash != scene.hash
    with pytest.raises(hybrid.UserError, match="path depth has changed"):
        hybrid.Renderer(scenes.load_scene("cornell", max_depth=scene.own_depth), forest)


def test_from_a_scene_to_a_forest(backend, tmp_path):
    captured, trained = [], []
    scene = scenes.load_scene(small.corner())
    frames = scenes.capture(
        scene,
        str(tmp_path / "frames"),
        hybrid.CaptureSettings(**CAPTURE),
        lambda *step: captured.append(step),
    )
    assert captured[-1][0] == captured[-1][1] > 0
    assert captured[-1][2] == "capture (samples)"
    again = scenes.load_frames(str(tmp_path / "frames"))
    assert again == frames
    assert (len(again.training), len(again.held_out)) == (2, 1)
    forest = scenes.train(
        frames,
        str(tmp_path / "a.forest"),
        hybrid.TrainingSettings(**TRAINING),
        lambda *step: trained.append(step),
    )
    assert trained[-1] == (2, 2, "train (steps)")
    for loaded in (scenes.load_forest(str(tmp_path / "a.forest")), load_forest(tmp_path / "a.forest")):
        assert loaded.digest() == forest.digest()
        assert loaded.scene_hash == hybrid.plan(scene).hash
    assert len(forest.counts) == 1


def test_progress_and_settings_may_be_left_out(backend, monkeypatch, tmp_path):
    given = []
    monkeypatch.setattr("pathtrace.dataset.capture.capture", lambda *arguments: given.append(arguments))
    monkeypatch.setattr(
        "hybrid.preparation.forest_training.train", lambda *arguments: given.append(arguments)
    )
    monkeypatch.setattr("hybrid.render.irradiance.cache_for", lambda scene, bars: f"cache of {scene}")
    monkeypatch.setattr("hybrid.preparation.scene_plan.as_planned", lambda scene, bars: scene)
    kept: list[object] = []
    monkeypatch.setattr("hybrid.base.cache_folder.keep_receipt", kept.append)
    scenes.capture("scene", tmp_path / "frames")
    scenes.train("frames", tmp_path / "a.forest")
    scenes.capture("scene", tmp_path / "frames", integrator="path")
    captured, trained, unbiased = given
    # One receipt per capture, of what it returned.
    assert len(kept) == 2
    assert (captured[4], unbiased[4]) == ("cache of scene", None)
    with pytest.raises(hybrid.UserError, match="integrator mlt"):
        scenes.capture("scene", tmp_path / "frames", integrator="mlt")
    assert captured[:3] == ("scene", tmp_path / "frames", hybrid.CaptureSettings())
    assert trained[:3] == ("frames", tmp_path / "a.forest", None)
    for progress in (captured[3], trained[3]):
        progress(1, 2)


@pytest.mark.parametrize("load", [scenes.load_frames, scenes.load_forest])
def test_what_is_not_there_is_named(load, backend, tmp_path):
    with pytest.raises(hybrid.UserError, match="nothing-here"):
        load(tmp_path / "nothing-here")
