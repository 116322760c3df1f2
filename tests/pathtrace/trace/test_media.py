"""What participating media, hidden lights and clipping planes leave of what is hit first."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from compose.base.traced_samples import DIFFUSE, SPECULAR
from pathtrace.fill.filling import fill_cache
from pathtrace.scene.optics import Optics
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import box_positions, clipped, opaque_camera, ray_through
from pathtrace.trace.first_hit import AuxiliaryFeatures, Unseen, Veil, first_hits, veil
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
FORWARD = [0, 0, 1]


def behind(sigma: float, **more: Any) -> Any:
    """A wall at z = 3, and a cube of a medium of albedo 0.6 in front of it, from z = 0 to 2."""
    wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 3]).scale(9)}
    medium = {"type": "homogeneous", "albedo": 0.6, "sigma_t": sigma}
    place = mi.ScalarTransform4f().translate([0, 0, 1])
    cube = {"type": "cube", "to_world": place, "bsdf": {"type": "null"}, "interior": medium}
    return mi.load_dict({"type": "scene", "wall": wall, "smoke": cube, **more})


def ray_from(z: float) -> Any:
    return mi.Ray3f(mi.Point3f(0, 0, z), mi.Vector3f(*FORWARD))


@pytest.mark.parametrize("sigma", [0.1, 1.0, 3.0, 50.0])
def test_a_medium_hides_what_hardly_any_light_passes(sigma):
    found = veil(behind(sigma), ray_from(-1), None, mi.Bool(True))
    left = np.exp(-2 * sigma)
    assert found.transmittance[0] == pytest.approx(left, rel=1e-3, abs=1e-6)
    assert np.array(found.albedo).ravel() == pytest.approx(np.full(3, 0.6 * (1 - left)), rel=1e-3)
    # Half of the light is left at ln 2 / sigma from the front, at a distance of 1.
    assert found.half[0] == pytest.approx(1 + np.log(2) / sigma if left < 0.05 else np.inf, rel=1e-3)


def test_a_ray_that_starts_in_a_medium_is_in_it_from_its_start():
    scene = behind(3.0)
    inside = scene.shapes()[1].interior_medium() or scene.shapes()[0].interior_medium()
    found = veil(scene, ray_from(0.5), inside, mi.Bool(True))
    assert found.half[0] == pytest.approx(np.log(2) / 3, rel=1e-3)
    assert found.transmittance[0] == pytest.approx(np.exp(-4.5), rel=1e-3)


def test_the_sky_is_seen_through_a_medium_without_an_end():
    scene = mi.load_dict({"type": "scene", "fog": {"type": "homogeneous", "sigma_t": 2.0}, **small.furnace()})
    medium = load_scene(
        {
            **small.furnace(),
            "fog": {"type": "homogeneous", "sigma_t": 2.0},
            "sensor": {**small.sensor(), "medium": {"type": "ref", "id": "fog"}},
        }
    ).optics.medium
    found = veil(scene, mi.Ray3f([0, 0, 9], FORWARD), medium, mi.Bool(True))
    assert found.half[0] == np.inf


def test_features_of_media_are_matt_and_face_the_ray():
    known = AuxiliaryFeatures(
        [mi.Float(0.2)] * 3, list(mi.Vector3f(1, 0, 0)), [mi.Float(9)] * 3, mi.Float(SPECULAR)
    )
    ray = ray_from(0)
    thick = Veil(mi.Float(2), mi.Float(0.25), mi.Color3f(0.5)).over(known, ray)
    assert [v[0] for v in thick.albedo] == pytest.approx([0.2 * 0.25 + 0.5] * 3)
    assert [v[0] for v in thick.normal] == pytest.approx([0.25, 0, -0.75])
    assert [v[0] for v in thick.position] == pytest.approx([0, 0, 2])
    assert thick.gloss[0] == DIFFUSE
    thin = Veil(mi.Float(dr.inf), mi.Float(1), mi.Color3f(0)).over(known, ray)
    assert [v[0] for v in (*thin.albedo, *thin.normal, *thin.position, thin.gloss)] == [
        *[pytest.approx(0.2)] * 3, 1, 0, 0, 9, 9, 9, SPECULAR
    ]  # fmt: skip


def test_rays_pass_what_cameras_do_not_see():
    lamp = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -0.5])}
    scene = behind(1.0, lamp={**lamp, "emitter": {"type": "area"}})
    distance = {
        sides: first_hits(scene, ray_from(-1), mi.Bool(True), 0, sides and Unseen(*sides)).surface.t[0]
        for sides in (None, (True, False), (False, True), (True, True))
    }
    assert list(distance.values()) == pytest.approx([0.5, 1, 0.5, 4], rel=1e-3)
    assert Unseen.of(scene, True) == Unseen(True, True)
    assert Unseen.of(mi.load_dict(small.corner()), False) is None


def test_rays_lie_between_clipping_planes():
    camera = load_scene(small.furnace()).camera
    numbers = opaque_camera(camera)
    ray = ray_through(numbers, mi.Float([0.5, 16, 31]), mi.Float([3.5, 16, 8]))
    within, start = clipped(ray, numbers, (0.4, 2.0))
    forward = mi.Vector3f(camera.camera_to_world[:3, 2])
    eye = mi.Point3f(camera.position)
    for at, depth in ((within.o, 0.4), (within(within.maxt), 2.0)):
        assert np.array(dr.dot(at - eye, forward)) == pytest.approx(np.full(3, depth), rel=1e-5)
    assert np.array(dr.norm(within.o - eye)) == pytest.approx(start.numpy(), rel=1e-5)


def test_hits_are_as_far_from_the_eye_whatever_is_clipped_in_front():
    scene = load_scene(small.corner())
    at = box_positions(*(np.full(1, value) for value in (20.0, 12.0, 1.0, 1.0)))
    whole = Tracer(scene).hits(scene.camera, at)
    beyond = Tracer(replace(scene, optics=Optics(clips=(0.2, 90.0)))).hits(scene.camera, at)
    assert beyond.distance == pytest.approx(whole.distance, rel=1e-5)
    cut = Tracer(replace(scene, optics=Optics(clips=(0.2, 0.5)))).hits(scene.camera, at)
    assert cut.distance[0] == np.inf


def test_no_cache_stands_for_light_in_media():
    scene = replace(load_scene(small.corner()), optics=Optics(has_media=True))
    assert len(fill_cache(scene, [scene.camera]).cells) == 0
