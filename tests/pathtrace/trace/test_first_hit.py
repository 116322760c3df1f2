"""What a ray sees, behind flat mirrors, round ones and glass."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from compose.image.gloss import DIFFUSE, SPECULAR
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
COLOUR = [0.7, 0.4, 0.2]


def looking_at(thing: dict) -> dict:
    """A camera at z = -1 that looks along +z at a thing at z = 1; one wall behind it, one beyond."""
    rectangle = mi.ScalarTransform4f
    wall = {"type": "diffuse", "reflectance": {"type": "rgb", "value": COLOUR}}
    return {
        "type": "scene",
        "sensor": {
            **small.sensor(16, 16, 10.0),
            "to_world": rectangle().look_at(origin=[0, 0, -1], target=[0, 0, 1], up=[0, 1, 0]),
        },
        "thing": thing,
        "behind": {
            "type": "rectangle",
            "to_world": rectangle().translate([0, 0, -3]).scale(20),
            "bsdf": wall,
        },
        "beyond": {
            "type": "rectangle",
            "to_world": rectangle().translate([0, 0, 4]).rotate([0, 1, 0], 180).scale(20),
            "bsdf": wall,
        },
        "lamp": {"type": "point", "position": [0, 5, -1], "intensity": {"type": "rgb", "value": 5.0}},
    }


def seen(thing: dict):
    scene = load_scene(looking_at(thing))
    auxiliary = Tracer(scene).auxiliary(scene.camera, frame_positions(scene.camera), 4, 0)
    image = lambda channels: np.stack([c.numpy() for c in channels], axis=-1)  # noqa: E731
    return image(auxiliary.albedo), image(auxiliary.normal), image(auxiliary.place), auxiliary.gloss.numpy()


def test_a_flat_mirror_shows_what_seems_to_stand_still_behind_it():
    facing = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([0, 1, 0], 180)
    mirror = {"type": "conductor", "specular_reflectance": {"type": "rgb", "value": 0.5}}
    albedo, normal, place, gloss = seen({"type": "rectangle", "to_world": facing, "bsdf": mirror})
    # The wall at z = -3 is 4 before the mirror at z = 1, its image as far behind.
    np.testing.assert_allclose(place[:, 2], 5, atol=1e-3)
    np.testing.assert_allclose(normal, np.broadcast_to([0, 0, 1], normal.shape), atol=1e-5)
    tint = albedo / np.array(COLOUR)
    assert tint.min() > 0.3
    assert tint.max() < 0.51
    assert (gloss == DIFFUSE).all()


@pytest.mark.parametrize("bsdf", ["conductor", "dielectric"])
def test_what_something_round_shows_lies_on_it(bsdf):
    ball = {"type": "sphere", "center": [0, 0, 1], "radius": 0.5, "bsdf": {"type": bsdf}}
    albedo, _, place, gloss = seen(ball)
    np.testing.assert_allclose(np.linalg.norm(place - [0, 0, 1], axis=1), 0.5, atol=1e-4)
    assert (gloss == SPECULAR).all()
    # One of the two walls, mirrored or through the glass; a thin rim shows the floorless sides.
    assert (albedo[:, 0] > albedo[:, 2]).mean() > 0.9


def test_without_mirrors_it_is_the_first_surface():
    wall = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}}
    facing = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([0, 1, 0], 180)
    albedo, _, place, gloss = seen({"type": "rectangle", "to_world": facing, "bsdf": wall})
    np.testing.assert_allclose(place[:, 2], 1, atol=1e-5)
    np.testing.assert_allclose(albedo, np.broadcast_to([0.1, 0.2, 0.3], albedo.shape), atol=1e-5)
    assert (gloss == DIFFUSE).all()
