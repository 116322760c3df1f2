"""Plans of small scenes of every kind, against what a careful person would write."""

from __future__ import annotations

import json
from typing import Any

import mitsuba as mi
import pytest

from compose.base.errors import UserError
from compose.eye.display import DISPLAYS
from hybrid.preparation.scene_plan import ScenePlan, plan_of
from pathtrace.scene.scene import load_scene
from tests import small
from tests.extremes import extreme

pytestmark = pytest.mark.usefixtures("backend")


def planned(scene: dict[str, Any], region: str = "near") -> ScenePlan:
    return plan_of(load_scene(scene), DISPLAYS["desktop"], (512, 512), region)


def evidence(plan: ScenePlan, name: str) -> dict[str, Any]:
    return next(decision.evidence for decision in plan.decisions if decision.name == name)


def grey(reflectance: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}}


def diffuse() -> dict[str, Any]:
    scene = small.corner()
    scene["ball"] = {**scene["ball"], "bsdf": grey(0.4)}
    return scene


def with_a_mirror() -> dict[str, Any]:
    scene = diffuse()
    scene["back"] = {**scene["back"], "bsdf": {"type": "twosided", "b": {"type": "conductor"}}}
    return scene


@pytest.fixture(scope="module")
def of_diffuse(backend) -> ScenePlan:
    return planned(diffuse())


@pytest.fixture(scope="module")
def of_mirror(backend) -> ScenePlan:
    return planned(with_a_mirror())


def test_a_diffuse_scene_has_no_harmonics_and_short_paths(of_diffuse):
    plan = of_diffuse
    assert plan.values()["degree"] == 0
    assert evidence(plan, "degree")["turning"] == 0
    assert 3 <= evidence(plan, "path depth")["needed"] <= 5
    assert plan.values()["light"] == "plain"
    assert plan.values()["motion"] == "still"


def test_a_scene_with_a_mirror_has_harmonics(of_mirror):
    plan = of_mirror
    assert plan.values()["degree"] == 2
    assert evidence(plan, "degree")["specular"] > 0.2


def test_a_lamp_of_ten_thousand_widens_the_range(of_diffuse):
    scene = diffuse()
    scene["bulb"] = {
        "type": "sphere",
        "center": [0.1, 0.5, 1.0],
        "radius": 0.1,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1e4}},
    }
    plan = planned(scene)
    found = evidence(plan, "frame precision")
    assert found["largest"] == pytest.approx(1e4, rel=0.05)
    assert found["stops"] > evidence(of_diffuse, "frame precision")["stops"]
    # Half precision ends at 65,504.
    assert plan.values()["frame precision"] == "float16"


def test_outdoors_light_comes_from_the_sky_at_once():
    scene = {
        "type": "scene",
        "sensor": small.sensor(),
        "ground": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, -0.5, 0]).rotate([1, 0, 0], -90).scale(20),
            "bsdf": grey(0.3),
        },
        "rock": {"type": "sphere", "center": [0, -0.3, 1.5], "radius": 0.3, "bsdf": grey(0.3)},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}},
    }
    plan = planned(scene)
    assert 2 <= evidence(plan, "path depth")["needed"] <= 4
    assert plan.values()["degree"] == 0


def test_glass_before_the_lamp_is_named():
    scene = diffuse()
    scene["lamp"]["to_world"] = (
        mi.ScalarTransform4f().look_at(origin=[0, 2.5, 1], target=[0, 0, 1], up=[0, 0, 1]).scale(0.3)
    )
    scene["pane"] = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 2.2, 1]).rotate([1, 0, 0], 90).scale(1.0),
        "bsdf": {"type": "thindielectric"},
    }
    plan = planned(scene)
    assert "panes" in plan.values()["light"]
    assert plan.values()["degree"] == 0


def test_what_is_seen_from_one_point_only_has_no_harmonics(of_mirror, tmp_path):
    """However much of it shines: nothing is ever seen from another direction."""
    point = {"radius": 1e-4, "frames": [{"position": [0, 0, -1], "look_at": [0, 0, 1], "up": [0, 1, 0]}]}
    (tmp_path / "point.json").write_text(json.dumps(point))
    plan = planned(with_a_mirror(), str(tmp_path / "point.json"))
    assert evidence(plan, "region")["is_one_point"]
    assert plan.values()["degree"] == 0
    assert plan.values()["region"] == str(tmp_path / "point.json")
    assert not evidence(of_mirror, "region")["is_one_point"]


@extreme("a plan of an empty scene", given="a sky, no shape", expected="one line that says so")
def test_an_empty_scene_is_refused(got):
    scene = {"type": "scene", "sensor": small.sensor(), "sky": {"type": "constant"}}
    with pytest.raises(UserError, match="surface") as refused:
        planned(scene)
    got(str(refused.value))
