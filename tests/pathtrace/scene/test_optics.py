"""Cameras of sensors, and what keeps light from converging."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from compose.base.errors import UserError
from pathtrace.scene.optics import camera_of_sensor, light_difficulties, perspective_sensor
from pathtrace.scene.scene import load_scene
from tests import small
from tests.pathtrace.scene.test_panes import scene, slab
from tests.pathtrace.scene.test_sunsky import scene as under_a_sky
from tests.pathtrace.scene.test_sunsky import sunsky

pytestmark = pytest.mark.usefixtures("backend")


def test_intrinsics_follow_from_field_of_view_and_film():
    """A field of view of 90 degrees has a focal length of half the side that it spans."""
    description = {**small.sensor(60, 40, 90.0), "principal_point_offset_x": 0.1}
    description["principal_point_offset_y"] = -0.25
    camera = camera_of_sensor(mi.load_dict(description), "mine")
    assert (camera.width, camera.height) == (60, 40)
    assert camera.fx == camera.fy == pytest.approx(20, rel=1e-5)
    assert (camera.cx, camera.cy) == (pytest.approx(24), pytest.approx(30))
    across = camera_of_sensor(mi.load_dict({**description, "fov_axis": "x"}), "mine")
    assert across.fx == across.fy == pytest.approx(30, rel=1e-5)


def test_the_pose_is_that_of_look_at():
    camera = camera_of_sensor(mi.load_dict(small.sensor()), "mine")
    np.testing.assert_allclose(camera.position, [0.3, 0.2, -1], atol=1e-6)
    # The target lies in the middle, what is above it higher up.
    pixels, depth = camera.project(np.array([[0.1, 0.0, 0.4], [0.1, 0.1, 0.4]]))
    np.testing.assert_allclose(pixels[0], [16, 16], atol=1e-4)
    assert pixels[1, 1] < 16
    assert (depth > 0).all()


def test_a_projected_point_is_where_the_sensor_has_it():
    """To 1e-3 pixels: the sensor's own direction sampling against Camera.project, off the film's centre."""
    description = small.sensor()
    description["principal_point_offset_x"] = 0.07
    description["principal_point_offset_y"] = -0.04
    sensor = mi.load_dict(description)
    point = np.array([[0.2, 0.1, 1.0]])
    expected, _ = camera_of_sensor(sensor, "mine").project(point)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.p = mi.Point3f(*point[0].tolist())
    sample, _ = sensor.sample_direction(si, mi.Point2f(0.5))
    np.testing.assert_allclose(np.array(sample.uv).ravel(), expected[0], atol=1e-3)


def test_a_crop_window_is_a_part_of_the_frame():
    """What Mitsuba's sensor shows in a corner of its film."""
    description = small.sensor(60, 40)
    description["film"] |= {"crop_offset_x": 7, "crop_offset_y": 5, "crop_width": 20, "crop_height": 30}
    sensor = mi.load_dict(description)
    camera = camera_of_sensor(sensor, "mine")
    assert (camera.width, camera.height) == (20, 30)
    ray, _ = sensor.sample_ray(0, 0, mi.Point2f(0.25, 0.8), mi.Point2f(0.5))
    pixel, _ = camera.project(np.array(ray.o + 2 * ray.d).T)
    np.testing.assert_allclose(pixel[0], [0.25 * 20, 0.8 * 30], atol=1e-3)


def test_a_thin_lens_counts_as_a_pinhole():
    description = small.sensor(60, 40)
    lens = {**description, "type": "thinlens", "aperture_radius": 0.1, "focus_distance": 2.0}
    assert camera_of_sensor(mi.load_dict(lens), "mine") == camera_of_sensor(mi.load_dict(description), "mine")


def test_the_first_perspective_sensor_is_used():
    scene = {"type": "scene", "plan": {"type": "orthographic"}, "a": small.sensor(), "b": small.sensor(9, 9)}
    assert perspective_sensor(mi.load_dict(scene), "mine").film().size()[0] == 32


def test_other_projections_are_refused():
    with pytest.raises(UserError, match=r"^mine: the camera is not a perspective one"):
        perspective_sensor(mi.load_dict({"type": "scene", "a": {"type": "orthographic"}}), "mine")


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
