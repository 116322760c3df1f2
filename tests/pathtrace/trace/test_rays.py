"""Rays of the tracer against the camera's own in double precision."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from compose.camera.camera import camera_from_pose, look_at
from pathtrace.trace.film import opaque_camera, ray_through
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def test_rays_agree_with_the_cameras():
    """A turned camera with unequal focal lengths and its principal point off the centre."""
    pose = look_at(np.array([1.0, 2, 3]), np.array([-2.0, 0.5, 7]), np.array([0.1, 1, 0.2]))
    camera = camera_from_pose(pose, 40, 30, 35.0, 28.0, 17.0, 19.5)
    pixels = small.rng().uniform(-10, 50, (200, 2))
    ray = ray_through(opaque_camera(camera), *(mi.Float(values) for values in pixels.T))
    directions = np.array(ray.d).T
    np.testing.assert_allclose(directions, camera.rays(pixels), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(np.array(ray.o).ravel(), [1, 2, 3], rtol=1e-6)


def test_points_on_a_ray_project_to_its_pixel():
    pose = look_at(np.zeros(3), np.array([0.3, 0.1, 1]), np.array([0.0, 1, 0]))
    camera = camera_from_pose(pose, 64, 48, 50.0, 50.0, 32.0, 24.0)
    ray = ray_through(opaque_camera(camera), mi.Float([3.25, 60.5]), mi.Float([40.0, 0.125]))
    pixels, depth = camera.project(np.array(ray(7.0)).T.astype(np.float64))
    np.testing.assert_allclose(pixels, [[3.25, 40], [60.5, 0.125]], atol=1e-3)
    assert (depth > 0).all()
