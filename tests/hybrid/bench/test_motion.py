"""The walk of `bench motion`."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Camera
from hybrid.bench.motion import FRAMES, walk

CAMERA = Camera(np.eye(4), 64, 48, 50.0, 50.0, 32.0, 24.0)


def test_a_walk_ends_at_the_camera_and_comes_from_the_left():
    path = walk(CAMERA, 2.0)
    assert len(path) == FRAMES
    np.testing.assert_allclose(path[-1].world_to_camera, CAMERA.world_to_camera, atol=1e-12)
    places = np.array([camera.position for camera in path])
    # 0.3 of the distance per second, at 30 frames per second.
    np.testing.assert_allclose(np.diff(places[:, 0]), 0.3 * 2 / 30, atol=1e-12)
    np.testing.assert_allclose(places[:, 1:], 0, atol=1e-12)
    forward = np.array([camera.camera_to_world[:3, 2] for camera in path])
    turns = np.degrees(np.arccos(np.clip(forward[:-1] @ CAMERA.camera_to_world[:3, 2], -1, 1)))
    np.testing.assert_allclose(turns[0], 15 * 10 / 30, atol=1e-6)
