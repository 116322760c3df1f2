"""Rays from points: closed forms of direct light, mirrors, and what is hit."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.cells import Points
from pathtrace.fill.filling import even_squares
from pathtrace.fill.gather import SAMPLES, Seen, gather_direct, gather_seen
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def floor_points(count: int) -> Points:
    position = np.tile(np.float32([0, 0, 0]), (count, 1))
    return Points(position, np.tile(np.float32([0, 1, 0]), (count, 1)))


RAYS = 4


def gather(scene: Any, points: Points, seed: int) -> tuple[np.ndarray, Seen]:
    """Light of lights at points, and what RAYS rays from each see in even directions."""
    square = even_squares(len(points), RAYS, np.random.default_rng(seed))
    point = np.repeat(np.arange(len(points)), RAYS)
    return gather_direct(scene, points, seed)[0], gather_seen(scene, points, point, square, seed + 1)


def test_in_a_closed_sphere_the_wall_gives_pi_times_its_emission():
    scene = mi.load_dict(small.furnace(0.5))
    direction = small.rng().normal(size=(2000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    points = Points((2.999 * direction).astype(np.float32), (-direction).astype(np.float32))
    direct, found = gather(scene, points, 1)
    error = direct.std() / np.sqrt(2000)
    assert direct.mean() == pytest.approx(0.5 * np.pi, abs=4 * error)
    assert (found.radiance == 0).all()
    assert found.valid.all()
    assert (found.bounces == 0).all()
    np.testing.assert_allclose(found.reflectance, 0.5, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(found.hits.position, axis=1), 3, rtol=1e-3)
    inward = (found.hits.position * found.hits.normal).sum(axis=1)
    assert (inward < 0).all()


def lamp(radiance: float) -> dict:
    place = mi.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(50)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    return {"type": "rectangle", "to_world": place, "emitter": emitter}


def ceiling(bsdf: dict) -> dict:
    place = mi.ScalarTransform4f().translate([0, 1, 0]).rotate([1, 0, 0], 90).scale(50)
    return {"type": "rectangle", "to_world": place, "bsdf": {"type": "twosided", "b": bsdf}}


@pytest.mark.parametrize(
    "bsdf",
    [
        {"type": "conductor", "specular_reflectance": 0.5},
        {"type": "roughconductor", "alpha": 0.1, "specular_reflectance": 0.5},
    ],
)
def test_light_seen_in_a_ceiling_of_metal_is_found(bsdf):
    """Above the lamp's plane, all of the hemisphere is a mirror that shows the lamp."""
    scene = mi.load_dict({"type": "scene", "lamp": lamp(2.0), "ceiling": ceiling(bsdf)})
    count = 4000
    direct, found = gather(scene, floor_points(count), 2)
    reflected = np.pi * found.radiance.mean(axis=1).reshape(count, RAYS).mean(axis=1)
    mean, error = reflected.mean(), reflected.std() / np.sqrt(count)
    # The plane metal of the default constants reflects nearly all of its specular reflectance.
    assert (direct == 0).all()
    assert (found.passed == 1).all()
    assert mean == pytest.approx(np.pi * 2.0 * 0.5, abs=0.15 * np.pi + 4 * error)
    assert error < 0.1


def test_rays_that_leave_the_scene_hit_nothing():
    scene = mi.load_dict({"type": "scene", "lamp": lamp(2.0)})
    _, found = gather(scene, floor_points(10), 3)
    assert len(found.valid) == 10 * RAYS
    assert not found.valid.any()
    assert (found.reflectance == 0).all()


def test_the_samples_of_a_light_that_no_ray_hits_add_up_to_direct_light():
    lamp = {"type": "point", "position": [0, 0, 0], "intensity": {"type": "rgb", "value": 3.0}}
    scene = mi.load_dict({**small.corner(), "lamp": lamp})
    points = Points(np.tile(np.float32([0, 0, 1.99]), (50, 1)), np.tile(np.float32([0, 0, -1]), (50, 1)))
    irradiance, samples = gather_direct(scene, points, 4)
    sums = np.bincount(samples.point, samples.irradiance) / SAMPLES
    np.testing.assert_allclose(sums, irradiance.mean(axis=1), rtol=1e-5)
    assert (samples.light == 0).all()
    assert sums.mean() == pytest.approx(3.0 / 1.99**2, rel=1e-4)


def test_a_lamp_that_touches_the_points_gives_pi_times_its_radiance_without_outliers():
    place = mi.ScalarTransform4f().translate([0, 1e-3, 0]).rotate([1, 0, 0], 90)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": 2.0}}
    scene = mi.load_dict(
        {"type": "scene", "lamp": {"type": "rectangle", "to_world": place, "emitter": emitter}}
    )
    irradiance, _ = gather_direct(scene, floor_points(2000), 5)
    assert irradiance.mean() == pytest.approx(2 * np.pi, rel=0.01)
    assert irradiance.max() < 3 * np.pi


def test_the_same_seed_gives_the_same_rays():
    scene = mi.load_dict(small.corner())
    points = Points(np.tile(np.float32([0, 0, 1.99]), (50, 1)), np.tile(np.float32([0, 0, -1]), (50, 1)))
    one, same, other = (gather(scene, points, seed)[1] for seed in (4, 4, 5))
    assert (one.hits.position == same.hits.position).all()
    assert (one.hits.position != other.hits.position).any()
