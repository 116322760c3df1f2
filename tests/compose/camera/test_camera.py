"""Cameras: axes, resizing, projection; the angles of the eye."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.axes import (
    mitsuba_from_opencv,
    opencv_from_mitsuba,
    opencv_from_opengl,
    opengl_from_opencv,
)
from compose.camera.camera import Camera, camera_from_pose, look_at
from compose.camera.serialization import camera_from_json, camera_to_json
from compose.eye.gaze import Gaze, eccentricity


def pose() -> np.ndarray:
    return look_at(np.array([1.0, 2.0, 3.0]), np.array([0.2, -0.5, 0.4]), np.array([0.0, 0.0, 1.0]))


def test_a_point_ahead_projects_to_the_principal_point():
    camera = camera_from_pose(pose(), 80, 60, 50, 55, 41, 29)
    pixels, depth = camera.project(camera.position[None] + 2.5 * pose()[:3, 2])
    np.testing.assert_allclose(pixels, [[41, 29]], atol=1e-9)
    np.testing.assert_allclose(depth, [2.5])


def test_up_in_the_world_is_up_in_the_picture():
    camera = camera_from_pose(pose(), 80, 60, 50, 50, 40, 30)
    ahead = camera.position + 3 * pose()[:3, 2]
    pixels, _ = camera.project(np.stack([ahead, ahead + np.array([0, 0, 0.1])]))
    assert pixels[1, 1] < pixels[0, 1]


def test_rays_go_back_through_the_pixels_they_came_from():
    camera = camera_from_pose(pose(), 80, 60, 50, 55, 41, 29)
    pixels = np.array([[0.5, 0.5], [79.5, 10.0], [33.0, 59.0]])
    back, depth = camera.project(camera.position + 4 * camera.rays(pixels))
    np.testing.assert_allclose(back, pixels, atol=1e-9)
    assert (depth > 0).all()


def test_axes_convert_there_and_back():
    np.testing.assert_allclose(opencv_from_mitsuba(mitsuba_from_opencv(pose())), pose())
    np.testing.assert_allclose(opencv_from_opengl(opengl_from_opencv(pose())), pose())


def test_a_scale_in_to_world_is_dropped():
    scaled = mitsuba_from_opencv(pose()) @ np.diag([2.0, 2.0, 2.0, 1.0])
    np.testing.assert_allclose(opencv_from_mitsuba(scaled), pose())


def test_json_holds_the_camera():
    camera = camera_from_pose(pose(), 80, 60, 50, 55, 41, 29)
    back = camera_from_json(camera_to_json(camera))
    np.testing.assert_allclose(back.world_to_camera, camera.world_to_camera, atol=1e-12)
    assert (back.width, back.height, back.fx, back.cy) == (80, 60, 50, 29)


def test_a_size_in_json_may_be_a_float_of_whole_pixels():
    entry = camera_to_json(camera_from_pose(pose(), 640, 480, 500, 500, 320, 240))
    camera = camera_from_json({**entry, "w": 640.0, "h": 480.0})
    assert (camera.width, camera.height) == (640, 480)
    assert isinstance(camera.width, int)
    assert isinstance(camera.height, int)


@pytest.mark.parametrize("name", ["w", "h"])
@pytest.mark.parametrize("size", [640.5, "640", None, True, [640], float("nan"), float("inf")])
def test_a_size_in_json_that_is_not_whole_pixels_is_refused_by_name(name, size):
    entry = camera_to_json(camera_from_pose(pose(), 640, 480, 500, 500, 320, 240))
    with pytest.raises(ValueError, match=f"^{name} is .*; must be a whole number of pixels"):
        camera_from_json({**entry, name: size})


def test_a_wider_frame_sees_more_and_keeps_its_height():
    camera = Camera(np.eye(4), 512, 512, 443.4, 443.4, 256, 256)
    wide = camera.resized(1024, 256)
    assert wide.vertical_fov == pytest.approx(camera.vertical_fov)
    assert wide.fx == wide.fy == pytest.approx(221.7)
    assert wide.cx == 512


@pytest.mark.parametrize(("width", "height", "focal"), [(0, 4, 1), (4, -1, 1), (4, 4, 0), (4, 4, np.nan)])
def test_impossible_cameras_are_refused(width, height, focal):
    with pytest.raises(ValueError, match=r"positive|finite"):
        Camera(np.eye(4), width, height, focal, focal, 2, 2)


def test_eccentricity_is_a_great_circle():
    """110 degrees wide and square: the corner lies at tan = sqrt(2) tan 55 deg, 63.66 degrees."""
    focal = 50 / np.tan(np.radians(55))
    camera = Camera(np.eye(4), 100, 100, focal, focal, 50, 50)
    angle = eccentricity(camera, Gaze())
    rays = camera.rays(np.array([[0.0, 0.0]]))
    corner = np.degrees(np.arccos(rays[0, 2]))
    assert corner == pytest.approx(np.degrees(np.arctan(np.sqrt(2) * np.tan(np.radians(55)))))
    assert angle[0, 0] == pytest.approx(corner, abs=0.5)
    # The four pixels around the gaze: half a diagonal away, arctan(sqrt(1/2) tan(55 deg) / 50).
    assert angle.min() == pytest.approx(1.1570, abs=1e-3)
    # Seen from the corner, the opposite one is twice as far.
    assert eccentricity(camera, Gaze(0, 0))[-1, -1] == pytest.approx(2 * corner, abs=0.5)


def test_a_gaze_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="finite"):
        Gaze(float("nan"), 0.5)
