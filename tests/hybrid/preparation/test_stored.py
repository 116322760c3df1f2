"""Plans in the cache folder, and scenes as planned."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from compose.base.errors import UserError
from hybrid.base.cache_folder import scene_folder
from hybrid.preparation import scene_plan as stored
from hybrid.preparation.scene_plan import (
    as_planned,
    as_stored,
    plan_for,
    require_plan,
    store_plan,
)
from hybrid.render.forest_attachments import attach_plan, plan_of_forest, scene_as_trained
from pathtrace.scene.scene import load_scene
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.extremes import extreme
from tests.hybrid.forests import rough_forest
from tests.moving import moving_corner

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def file_of(scene):
    return scene_folder(scene.name, scene.own_hash) / "plan.json"


def test_a_scene_is_planned_once_and_loaded_as_planned(monkeypatch):
    assert as_stored(load_scene("cornell")).plan == {}
    first = as_planned(load_scene("cornell"))
    assert first.max_depth == first.plan["path depth"] == -1
    assert first.roulette_depth == first.plan["roulette depth"]
    assert first.hash != first.own_hash
    monkeypatch.setattr(stored, "plan_of", None)
    again = as_planned(load_scene("cornell"))
    assert (again.hash, again.plan) == (first.hash, first.plan)
    assert as_stored(load_scene("cornell")).hash == first.hash


def test_a_depth_that_is_given_stays():
    scene = as_planned(load_scene("cornell", 3))
    assert scene.max_depth == scene.plan["path depth"] == 3
    assert scene.hash == load_scene("cornell", 3).hash
    assert load_scene("cornell").at_depth(3).hash == scene.hash


def test_items_that_are_overridden_are_so_for_one_scene():
    scene = as_planned(load_scene("cornell"), override={"gaussians": 123, "path depth": 4})
    assert (scene.plan["gaussians"], scene.max_depth) == (123, 4)
    assert as_stored(load_scene("cornell")).plan["gaussians"] != 123
    assert as_planned(load_scene("cornell", 3), override={"path depth": 4}).max_depth == 3
    empty = {"type": "scene", "sensor": small.sensor(), "sky": {"type": "constant"}}
    with pytest.raises(UserError, match="has no plan of which degree could be overridden"):
        as_planned(load_scene(empty), override={"degree": 1})


def test_loading_renders_nothing(monkeypatch):
    monkeypatch.setattr(stored, "look_at_scene", lambda *arguments: pytest.fail("looked at"))
    scene = as_stored(load_scene(small.corner()))
    assert (scene.plan, scene.hash) == ({}, scene.own_hash)
    assert as_stored(load_scene("cornell", 3)).max_depth == 3


def test_without_a_plan_a_scene_has_that_of_the_forest():
    plan = {"path depth": 7, "roulette depth": 3, "degree": 0}
    scene = load_scene(small.corner())
    planned = scene.planned(plan)
    trained = replace(attach_plan(rough_forest(planned), plan), scene_hash=planned.hash)
    found = scene_as_trained(scene, trained)
    assert (found.hash, found.max_depth, found.roulette_depth, found.plan) == (planned.hash, 7, 3, plan)
    # A plan of the scene's own, a depth that was asked for, and a forest of something else change nothing.
    for own in (scene.planned({**plan, "path depth": 2}), load_scene(small.corner(), 5)):
        assert scene_as_trained(own, trained) is own
    assert scene_as_trained(scene, replace(trained, scene_hash="ab" * 32)) is scene
    assert scene_as_trained(scene, rough_forest(scene)) is scene
    for damaged in ({**plan, "path depth": "7"}, {**plan, "roulette depth": 0}, {"degree": 0}):
        assert scene_as_trained(scene, attach_plan(trained, damaged)) is scene


def test_paths_are_as_planned():
    """With roulette from the second segment on, hardly anything changes but the noise."""
    scene = load_scene(small.furnace(0.5))
    assert scene.at_depth(scene.own_depth).hash == scene.hash == scene.own_hash
    assert Tracer(scene.at_depth(2))._settings.max_depth == 2
    assert Tracer(scene)._settings.roulette_depth == scene.roulette_depth


@pytest.mark.parametrize("text", ["", "{", "[]", '{"version": 0}', '{"version": 1, "scene": "x"}'])
def test_a_damaged_plan_is_made_again(text):
    scene = load_scene(small.corner())
    plan = plan_for(scene)
    file_of(scene).write_text(text)
    again = plan_for(scene)
    assert again.values() == plan.values()
    assert json.loads(file_of(scene).read_text())["scene"] == scene.own_hash


@extreme("a plan that contradicts the scene", given="still, of a scene that moves", expected="one line")
def test_a_plan_that_contradicts_the_scene_is_refused(tmp_path, got):
    scene = moving_corner(tmp_path)
    store_plan(plan_for(scene))
    content = json.loads(file_of(scene).read_text())
    content["decisions"][0]["value"] = "still"
    file_of(scene).write_text(json.dumps(content))
    with pytest.raises(UserError, match="its plan has motion still, but") as refused:
        plan_for(scene)
    got(str(refused.value))
    still = load_scene(small.corner())
    require_plan({"motion": "still"}, still, "x")
    with pytest.raises(UserError, match="x: its plan has motion moving"):
        require_plan({"motion": "moving"}, still, "x")


@extreme("a scene that cannot be looked at", given="a sky, no shape", expected="loaded, not planned")
def test_what_cannot_be_looked_at_is_loaded_without_a_plan(caplog, got):
    empty = {"type": "scene", "sensor": small.sensor(), "sky": {"type": "constant"}}
    scene = as_planned(load_scene(empty))
    assert (scene.plan, scene.max_depth) == ({}, scene.own_depth)
    (said,) = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert said.endswith("; using defaults")
    got(said)


def test_a_forest_says_what_was_planned_for_it():
    forest = rough_forest(load_scene(small.corner()))
    assert plan_of_forest(forest) == {}
    assert attach_plan(forest, {}) is forest
    values = {"motion": "still", "degree": 0, "path depth": 5}
    attached = attach_plan(forest, values)
    assert plan_of_forest(attached) == values
    damaged = attached.attached["plan.json"].clone()
    damaged[0] = 0
    attached.attached["plan.json"] = damaged
    with pytest.raises(UserError, match="plan is damaged"):
        plan_of_forest(attached)
