"""Rigid motion as keyframes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pathtrace.gltf.movement import is_rigid, keyframes_of, without_scale
from pathtrace.scene.motion_file import RigidTrack
from tests.pathtrace.gltf.building import BOX

TIMES = np.linspace(0, 1, 97)


def turning(degrees, axis=(0.0, 0.0, 1.0), shift=(0.0, 0.0, 0.0)):
    """(T, 4, 4) of a turn at a constant speed, by so many degrees in all, and a shift."""
    poses = np.tile(np.eye(4), (len(TIMES), 1, 1))
    vectors = np.radians(degrees) * TIMES[:, None] * (np.array(axis) / np.linalg.norm(axis))
    poses[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
    poses[:, :3, 3] = TIMES[:, None] * np.array(shift)
    return poses


def farthest(keyframes, poses, about):
    """How far corners are, at most, from where poses bring them."""
    track = RigidTrack(tuple(keyframes), about=tuple(about))
    found = np.stack([track.pose(time) for time in TIMES])
    away = np.einsum("tij,nj->tni", (found - poses)[:, :3, :3], BOX) + (found - poses)[:, None, :3, 3]
    return np.linalg.norm(away, axis=2).max()


def test_a_shift_and_a_turn_of_less_than_half_need_two_keyframes():
    poses = turning(120, (1, 1, 0), (3, 0, 1))
    keyframes = keyframes_of(TIMES, poses, np.zeros(3), BOX)
    assert [key.time for key in keyframes] == [0, 1]
    assert farthest(keyframes, poses, np.zeros(3)) < 1e-12


@pytest.mark.parametrize("degrees", [180, 360, -540, 1080])
def test_turns_go_the_right_way_round(degrees):
    poses = turning(degrees)
    keyframes = keyframes_of(TIMES, poses, np.zeros(3), BOX)
    assert farthest(keyframes, poses, np.zeros(3)) < 1e-9
    assert len(keyframes) <= abs(degrees) / 60 + 2


def test_curved_ways_are_met_within_the_tolerance():
    about = np.array([0.1, 0.0, 0.3])
    poses = turning(200, (0, 1, 0))
    poses[:, 0, 3] = np.sin(2 * TIMES)
    keyframes = keyframes_of(TIMES, poses, about, BOX)
    assert farthest(keyframes, poses, about) <= 3e-4 * np.linalg.norm(np.ptp(BOX, axis=0))
    assert len(keyframes) < len(TIMES)


def test_scales_and_mirrors_are_not_rigid():
    poses = turning(90)
    assert is_rigid(poses)
    for scale in ((1, 1, 1.01), (-1, 1, 1), (2, 2, 2)):
        scaled = poses.copy()
        scaled[3, :3, :3] = scaled[3, :3, :3] * scale
        assert not is_rigid(scaled)
        np.testing.assert_allclose(np.linalg.det(without_scale(scaled)), 1)


def test_what_is_scaled_evenly_keeps_its_turn():
    poses = turning(90, (1, 2, 3), (1, 2, 3))
    scaled = poses.copy()
    scaled[:, :3, :3] *= 7
    np.testing.assert_allclose(without_scale(scaled), poses, atol=1e-12)
