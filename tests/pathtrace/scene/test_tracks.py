"""Where tracks are at a time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pathtrace.scene.motion_file import Brightness, Keyframe, LightTrack, RigidTrack


def test_a_rigid_track_turns_about_its_axis_and_shifts():
    track = RigidTrack(
        (Keyframe(0.2), Keyframe(0.6, (2.0, 0, 0), 180.0)), axis=(0.0, 0.0, 1.0), about=(1.0, 0.0, 0.0)
    )
    half = track.pose(0.4)
    np.testing.assert_allclose(half @ [1, 0, 5, 1], [2, 0, 5, 1], atol=1e-12)
    np.testing.assert_allclose(half @ [2, 0, 0, 1], [2, 1, 0, 1], atol=1e-12)
    for early, late in ((0.0, 0.2), (1.0, 0.6)):
        np.testing.assert_array_equal(track.pose(early), track.pose(late))
    np.testing.assert_array_equal(track.pose(0.0), np.eye(4))


def test_poses_are_rigid_around_any_axis():
    axis = np.array([1.0, -2.0, 0.5])
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    track = RigidTrack((Keyframe(0.0), Keyframe(1.0, (0.1, 0.2, 0.3), 1234.0)), (x, y, z), (3.0, 1.0, 2.0))
    rotation = track.pose(0.7)[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation @ [x, y, z], [x, y, z], atol=1e-12)
    assert np.trace(rotation) == pytest.approx(1 + 2 * np.cos(np.radians(0.7 * 1234)))


def test_quaternions_turn_around_any_axis_at_a_constant_speed():
    half, third = np.radians(80) / 2, np.radians(80) / 6
    axis = np.array([1.0, 2.0, -2.0]) / 3
    x, y, z = (np.sin(half) * axis).tolist()
    # The negative of a quaternion is the same turn.
    keys = (
        Keyframe(0.1, rotation=(1.0, 0, 0, 0)),
        Keyframe(0.7, (3.0, 0, 0), rotation=(-np.cos(half), -x, -y, -z)),
    )
    track = RigidTrack(keys, about=(0.0, 5.0, 0.0))
    wanted = Rotation.from_quat([*(np.sin(third) * axis), np.cos(third)]).as_matrix()
    pose = track.pose(0.3)
    np.testing.assert_allclose(pose[:3, :3], wanted, atol=1e-12)
    np.testing.assert_allclose(pose @ [0, 5, 0, 1], [1, 5, 0, 1], atol=1e-12)
    np.testing.assert_allclose(track.pose(1.0), track.pose(0.7), atol=1e-12)


def test_a_single_quaternion_holds_for_ever():
    track = RigidTrack((Keyframe(0.5, rotation=(0.0, 0.0, 0.0, 1.0)),))
    for time in (0.0, 0.5, 1.0):
        np.testing.assert_allclose(track.pose(time), np.diag([-1.0, -1, 1, 1]), atol=1e-12)


def test_quaternions_are_in_all_keyframes_or_in_none():
    with pytest.raises(ValueError, match="rotation in all keyframes, or in none"):
        RigidTrack((Keyframe(0.0), Keyframe(1.0, rotation=(1.0, 0.0, 0.0, 0.0))))


def test_brightness_is_linear_between_keyframes():
    track = LightTrack((Brightness(0.0, (1.0, 1.0, 1.0)), Brightness(0.5, (0.0, 2.0, 1.0))))
    np.testing.assert_allclose(track.factor(0.25), [0.5, 1.5, 1])
    np.testing.assert_allclose(track.factor(0.9), [0, 2, 1])


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([], "no keyframes"),
        ([0.5, 0.2], "out of order"),
        ([0.5, 0.5], "out of order"),
        ([-0.1, 0.5], "t = -0.1; must be from 0 to 1"),
        ([0, 1.5], "t = 1.5; must be from 0 to 1"),
    ],
)
def test_keyframes_are_in_order_and_within_the_time(times, said):
    with pytest.raises(ValueError, match=said):
        RigidTrack(tuple(Keyframe(time) for time in times))
    with pytest.raises(ValueError, match=said):
        LightTrack(tuple(Brightness(time, (1.0, 1.0, 1.0)) for time in times))
