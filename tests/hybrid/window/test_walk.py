"""Walking and looking: directions as the keys say, the horizon level."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import camera_from_pose, look_at
from hybrid.window.key_bindings import Walker

HOME = camera_from_pose(
    look_at(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.5, 0.0]), np.array([0.0, 1.0, 0.0])),
    *(64, 48, 50.0, 50.0, 32.0, 24.0),
)


def middle(walker: Walker) -> np.ndarray:
    """The direction that the middle of the frame looks at, in axes of the home camera."""
    camera = walker.camera(64, 48)
    return HOME.world_to_camera[:3, :3] @ camera.rays(np.array([[32.0, 24.0]]))[0]


def test_nothing_moves_at_home():
    walker = Walker(HOME)
    assert walker.camera(64, 48).key == HOME.key
    walker.look(10, 5)
    walker.walk(1, 1, 1)
    walker.reset()
    assert walker.camera(64, 48).key == HOME.key


def test_looking_right_and_down_turns_that_way():
    walker = Walker(HOME)
    walker.look(30, 0)
    assert middle(walker) == pytest.approx([0.5, 0, np.sqrt(0.75)])
    walker.look(-30, 20)
    assert middle(walker) == pytest.approx([0, np.sin(np.radians(20)), np.cos(np.radians(20))])


def test_one_walks_where_one_looks():
    walker = Walker(HOME)
    walker.look(90, 0)
    walker.walk(0, 0, 2)
    moved = HOME.world_to_camera[:3, :3] @ (walker.camera(64, 48).position - HOME.position)
    assert moved == pytest.approx([2, 0, 0], abs=1e-12)


def test_the_horizon_stays_level_and_nobody_turns_over():
    walker = Walker(HOME)
    for _ in range(50):
        walker.look(13, 7)
    camera = walker.camera(64, 48)
    right = HOME.world_to_camera[:3, :3] @ camera.camera_to_world[:3, 0]
    assert right[1] == pytest.approx(0, abs=1e-12)
    assert middle(walker)[1] == pytest.approx(np.sin(np.radians(85)))
    rotation = camera.camera_to_world[:3, :3]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_the_frame_may_have_any_size():
    walker = Walker(HOME)
    walker.look(5, 5)
    camera = walker.camera(200, 96)
    assert (camera.width, camera.height) == (200, 96)
    assert camera.vertical_fov == pytest.approx(HOME.vertical_fov)


def test_the_camera_is_the_same_object_until_something_changes():
    walker = Walker(HOME)
    changes = (
        lambda: walker.look(5, 0),
        lambda: walker.walk(0, 0, 1),
        walker.reset,
    )
    seen = [walker.camera(64, 48)]
    for change in changes:
        assert walker.camera(64, 48) is seen[-1]
        change()
        seen.append(walker.camera(64, 48))
    assert len({camera.key for camera in seen}) == 3
    assert seen[-1] == seen[0]
    assert (walker.camera(64, 50).width, walker.camera(64, 50).height) == (64, 50)
    assert (walker.camera(70, 50).width, walker.camera(70, 50).height) == (70, 50)
