"""Pinhole cameras: projection, rays, resizing, equality, turning, two eyes, times among steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.camera.camera import Camera, between_steps, camera_from_pose, eyes, look_at, turned

POSITION, TARGET = np.array([1.0, 2.0, 3.0]), np.array([0.2, -0.5, 0.4])
POSE = look_at(POSITION, TARGET, np.array([0.0, 0.0, 1.0]))
CAMERA = camera_from_pose(POSE, 80, 60, 50, 55, 41, 29)


def test_a_point_projects_as_by_hand():
    """x = 50 * 1 / 5 + 41 and y = 55 * 2 / 5 + 29."""
    camera = Camera(np.eye(4), 80, 60, 50, 55, 41, 29)
    pixels, depth = camera.project(np.array([[1.0, 2.0, 5.0], [0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(pixels, [[51, 51], [41, 29]])
    np.testing.assert_allclose(depth, [5, 2])


def test_look_at_sees_its_target_in_the_middle():
    assert np.linalg.det(POSE[:3, :3]) == pytest.approx(1)
    np.testing.assert_allclose(POSE[:3, :3].T @ POSE[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(CAMERA.position, POSITION)
    pixels, depth = CAMERA.project(TARGET[None])
    np.testing.assert_allclose(pixels, [[41, 29]], atol=1e-9)
    np.testing.assert_allclose(depth, [np.linalg.norm(TARGET - POSITION)])


def test_up_in_the_world_is_up_in_the_image_and_the_horizon_is_level():
    pixels, _ = CAMERA.project(np.stack([TARGET, TARGET + np.array([0, 0, 0.1])]))
    assert pixels[1, 1] < pixels[0, 1]
    assert pixels[1, 0] == pytest.approx(pixels[0, 0])


def test_the_pose_is_the_inverse_of_the_view():
    np.testing.assert_allclose(CAMERA.camera_to_world, POSE, atol=1e-12)
    np.testing.assert_allclose(CAMERA.camera_to_world @ CAMERA.world_to_camera, np.eye(4), atol=1e-12)


def test_rays_pass_through_their_pixels():
    pixels = np.array([[0.5, 0.5], [79.5, 10.0], [33.0, 59.0]])
    rays = CAMERA.rays(pixels)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1)
    back, depth = CAMERA.project(CAMERA.position + 4 * rays)
    np.testing.assert_allclose(back, pixels, atol=1e-9)
    assert (depth > 0).all()


def test_pixel_centres_go_row_by_row_from_the_top():
    camera = Camera(np.eye(4), 3, 2, 1, 1, 0, 0)
    expected = [[0.5, 0.5], [1.5, 0.5], [2.5, 0.5], [0.5, 1.5], [1.5, 1.5], [2.5, 1.5]]
    assert camera.pixel_centres().tolist() == expected


def test_the_vertical_field_of_view_adds_both_sides_of_the_principal_point():
    """arctan(100 / 100) on both sides; arctan(1) + arctan(2) off the centre."""
    assert Camera(np.eye(4), 10, 200, 7, 100, 5, 100).vertical_fov == pytest.approx(90)
    assert Camera(np.eye(4), 10, 150, 7, 50, 5, 50).vertical_fov == pytest.approx(108.43495)


def test_a_wider_frame_sees_more_and_keeps_its_height():
    camera = Camera(np.eye(4), 512, 512, 443.4, 443.4, 256, 256)
    wide = camera.resized(1024, 256)
    assert wide.vertical_fov == pytest.approx(camera.vertical_fov)
    assert wide.fx == wide.fy == pytest.approx(221.7)
    assert wide.cx == 512


def test_resizing_scales_the_offset_of_the_principal_point():
    """Twice as high: the point lies 1 pixel right of the centre before, and 2 after."""
    large = CAMERA.resized(200, 120)
    assert (large.width, large.height) == (200, 120)
    assert (large.fx, large.fy, large.cx, large.cy) == (100, 110, 102, 58)
    assert large.world_to_camera is CAMERA.world_to_camera


def test_a_crop_sees_the_same_points_from_its_corner():
    crop = CAMERA.cropped(10, 20, 30, 25)
    assert (crop.width, crop.height) == (30, 25)
    np.testing.assert_allclose(crop.project(TARGET[None])[0], [[31, 9]], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("width", 0, "0 x 60 must be positive"),
        ("height", -1, "80 x -1 must be positive"),
        ("fx", 0.0, "focal length"),
        ("fy", -1.0, "focal length"),
        ("fx", np.nan, "finite"),
        ("cx", np.inf, "finite"),
        ("cy", np.nan, "finite"),
        ("world_to_camera", np.diag([1.0, 1.0, np.inf, 1.0]), "finite"),
    ],
)
def test_impossible_cameras_are_refused(name, value, said):
    with pytest.raises(ValueError, match=said):
        replace(CAMERA, **{name: value})


def test_one_pixel_is_a_frame():
    assert replace(CAMERA, width=1, height=1).pixel_centres().tolist() == [[0.5, 0.5]]


def test_a_principal_point_outside_the_frame_is_allowed():
    assert CAMERA.cropped(100, 100, 8, 8).cx == -59


def test_cameras_with_the_same_numbers_are_equal():
    again = camera_from_pose(POSE.copy(), 80, 60, 50, 55, 41, 29)
    assert again is not CAMERA
    assert again == CAMERA
    assert hash(again) == hash(CAMERA)
    assert {CAMERA: "found"}[again] == "found"


@pytest.mark.parametrize("name", ["width", "height", "fx", "fy", "cx", "cy", "world_to_camera"])
def test_cameras_that_differ_in_any_number_are_not_equal(name):
    value = getattr(CAMERA, name)
    other = replace(CAMERA, **{name: value + (1 if isinstance(value, int) else 1e-9)})
    assert other != CAMERA
    assert other.key != CAMERA.key


def test_a_camera_is_not_equal_to_anything_else():
    assert CAMERA.key != CAMERA
    assert (CAMERA == 3) is False


def test_intrinsics_become_floats():
    assert all(type(getattr(CAMERA, name)) is float for name in ("fx", "fy", "cx", "cy"))


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


@pytest.mark.parametrize(
    ("time", "count", "first", "share"),
    [
        (0.0, 2, 0, 0.0),
        (1.0, 2, 0, 1.0),
        (0.25, 2, 0, 0.25),
        (0.5, 5, 2, 0.0),
        (0.9, 5, 3, 0.6),
        (1.0, 5, 3, 1.0),
    ],
)
def test_a_time_lies_between_two_values(time, count, first, share):
    assert between_steps(time, count) == (first, pytest.approx(share))
