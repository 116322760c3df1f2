"""Axis conventions, checked by where a point appears."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import camera_from_pose, look_at
from compose.camera.coordinate_systems import (
    mitsuba_from_opencv,
    opencv_from_mitsuba,
    opencv_from_opengl,
    opengl_from_opencv,
)

POSE = look_at(np.array([1.0, 2.0, 3.0]), np.array([0.2, -0.5, 0.4]), np.array([0.0, 0.0, 1.0]))


def seen_at(camera_to_world: np.ndarray, point: list[float]) -> tuple[list[float], float]:
    """Pixel and depth of a point at a focal length of 50 pixels, the principal point at 0."""
    camera = camera_from_pose(camera_to_world, 64, 64, 50, 50, 0, 0)
    pixel, depth = camera.project(np.array([point]))
    return pixel[0].tolist(), float(depth[0])


def test_mitsuba_looks_along_z_with_x_to_the_left_and_y_up():
    assert seen_at(opencv_from_mitsuba(np.eye(4)), [1, 2, 5]) == ([-10, -20], 5)


def test_opengl_looks_against_z_with_x_to_the_right_and_y_up():
    assert seen_at(opencv_from_opengl(np.eye(4)), [1, 2, -5]) == ([10, -20], 5)


def test_the_camera_stays_where_it_is():
    for converted in (opencv_from_mitsuba(POSE), opencv_from_opengl(POSE), mitsuba_from_opencv(POSE)):
        np.testing.assert_allclose(converted[:3, 3], [1, 2, 3], atol=1e-12)


def test_conversions_invert_each_other():
    np.testing.assert_allclose(opencv_from_mitsuba(mitsuba_from_opencv(POSE)), POSE)
    np.testing.assert_allclose(opencv_from_opengl(opengl_from_opencv(POSE)), POSE)


def test_a_scale_in_to_world_is_removed():
    scaled = mitsuba_from_opencv(POSE) @ np.diag([2.0, 3.0, 0.5, 1.0])
    before = scaled.copy()
    np.testing.assert_allclose(opencv_from_mitsuba(scaled), POSE)
    assert np.array_equal(scaled, before)
