"""Where two eyes are, and what they see."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import Camera, camera_from_pose, eyes, look_at


def viewer() -> Camera:
    pose = look_at(np.array([1.0, 2.0, -3.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    return camera_from_pose(pose, 48, 32, 40.0, 40.0, 24.0, 16.0)


@pytest.mark.parametrize("distance", [0.0, 0.063, 2.0])
def test_eyes_are_beside_each_other_and_look_the_same_way(distance):
    camera = viewer()
    left, right = eyes(camera, distance)
    across = camera.camera_to_world[:3, 0]
    np.testing.assert_allclose(right.position - left.position, distance * across, atol=1e-12)
    np.testing.assert_allclose((right.position + left.position) / 2, camera.position, atol=1e-12)
    for eye in (left, right):
        np.testing.assert_array_equal(eye.world_to_camera[:3, :3], camera.world_to_camera[:3, :3])
        assert (eye.width, eye.height, eye.fx) == (camera.width, camera.height, camera.fx)


def test_what_is_near_lies_further_right_for_the_left_eye():
    camera = viewer()
    point = camera.position + 2 * camera.camera_to_world[:3, 2]
    left, right = (eye.project(point[None])[0][0, 0] for eye in eyes(camera, 0.1))
    assert left - right == pytest.approx(0.1 / 2 * camera.fx)
