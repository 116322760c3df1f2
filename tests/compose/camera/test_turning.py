"""Yaw and pitch of a camera."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import turned

FORWARD = np.array([0.0, 0.0, 1.0])


def test_positive_yaw_looks_right_and_positive_pitch_up():
    """OpenCV axes: x points right, y down."""
    np.testing.assert_allclose(turned(np.eye(3), 90, 0) @ FORWARD, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turned(np.eye(3), 0, 90) @ FORWARD, [0, -1, 0], atol=1e-12)


def test_yaw_then_pitch_by_hand():
    """To the right by 90 degrees, then up by 30: cos 30 and sin 30 remain."""
    expected = [np.sqrt(3) / 2, -0.5, 0]
    np.testing.assert_allclose(turned(np.eye(3), 90, 30) @ FORWARD, expected, atol=1e-12)


@pytest.mark.parametrize(("yaw", "pitch"), [(0, 0), (20, -10), (-130, 60)])
def test_the_result_is_a_rotation_with_a_level_horizon(yaw, pitch):
    rotation = turned(np.eye(3), yaw, pitch)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    # The camera's x axis has no vertical part.
    assert rotation[1, 0] == pytest.approx(0, abs=1e-12)


def test_a_camera_turns_about_its_own_axes():
    """A camera that looks down sees what was above its frame after pitching up by 90 degrees."""
    down = turned(np.eye(3), 0, -90)
    np.testing.assert_allclose(turned(down, 0, 90), np.eye(3), atol=1e-12)
    # Its own y axis points backwards in the world, so that yaw does not change its height.
    np.testing.assert_allclose(turned(down, 90, 0) @ FORWARD, [1, 0, 0], atol=1e-12)
