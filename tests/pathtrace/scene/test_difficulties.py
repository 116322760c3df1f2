"""What keeps light from converging is named, and nothing else."""

from __future__ import annotations

import pytest

from pathtrace.scene.optics import light_difficulties
from pathtrace.scene.scene import load_scene
from tests import small
from tests.pathtrace.scene.test_panes import scene, slab
from tests.pathtrace.scene.test_sunsky import scene as under_a_sky
from tests.pathtrace.scene.test_sunsky import sunsky

pytestmark = pytest.mark.usefixtures("backend")


def kinds(description, **options) -> list[str]:
    return [one.kind for one in light_difficulties(load_scene(description, **options))]


@pytest.mark.parametrize("name", ["room", "cornell"])
def test_the_bundled_scenes_have_none(name):
    assert kinds(name) == []


def test_panes_are_named_unless_they_let_shadow_rays_pass():
    found = light_difficulties(load_scene(scene(slab(0.05))))
    assert [one.kind for one in found] == ["panes"]
    assert "thin_glass" in str(found[0])
    assert kinds(scene(slab(0.05)), thin_glass=True) == []


@pytest.mark.parametrize("aperture", [None, 10.0])
def test_a_sun_and_a_mirror_make_caustics(aperture):
    description = under_a_sky(sunsky(aperture))
    assert kinds(description) == ["caustics"]
    description["ball"] = {**description["ball"], "bsdf": {"type": "roughconductor", "alpha": 0.1}}
    assert kinds(description) == ["caustics"]
    description["ball"] = {**description["ball"], "bsdf": {"type": "roughconductor", "alpha": 0.5}}
    assert kinds(description) == []


def test_a_mirror_under_a_tiny_lamp_but_not_under_a_large_one():
    description = small.corner()
    assert kinds(description) == []
    lamp = description["lamp"]
    description["lamp"] = {**lamp, "to_world": lamp["to_world"] @ type(lamp["to_world"])().scale(0.05)}
    found = light_difficulties(load_scene(description))
    assert [one.kind for one in found] == ["caustics"]
    assert "\n" not in str(found[0])
