"""Cameras as JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest

from compose.camera.camera import Camera, camera_from_pose, look_at
from compose.camera.coordinate_systems import camera_from_json, camera_to_json

POSE = look_at(np.array([1.0, 2.0, 3.0]), np.array([0.2, -0.5, 0.4]), np.array([0.0, 0.0, 1.0]))
CAMERA = camera_from_pose(POSE, 640, 480, 500, 510, 321, 239)


def test_the_names_and_axes_are_those_of_transforms_json():
    entry = camera_to_json(Camera(np.eye(4), 80, 60, 50, 55, 41, 29))
    assert entry == {
        "w": 80,
        "h": 60,
        "fl_x": 50,
        "fl_y": 55,
        "cx": 41,
        "cy": 29,
        "transform_matrix": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]],
    }


def test_a_camera_comes_back_from_json():
    back = camera_from_json(json.loads(json.dumps(camera_to_json(CAMERA))))
    np.testing.assert_allclose(back.world_to_camera, CAMERA.world_to_camera, atol=1e-12)
    assert (back.width, back.height) == (640, 480)
    assert (back.fx, back.fy, back.cx, back.cy) == (500, 510, 321, 239)


def test_a_size_may_be_a_float_of_whole_pixels():
    camera = camera_from_json({**camera_to_json(CAMERA), "w": 640.0, "h": 480.0})
    assert (camera.width, camera.height) == (640, 480)
    assert isinstance(camera.width, int)
    assert isinstance(camera.height, int)


@pytest.mark.parametrize("name", ["w", "h"])
@pytest.mark.parametrize("size", [640.5, "640", None, True, [640], float("nan"), float("inf")])
def test_a_size_that_is_not_whole_pixels_is_refused_by_name(name, size):
    with pytest.raises(ValueError, match=f"^{name} is .*; must be a whole number of pixels"):
        camera_from_json({**camera_to_json(CAMERA), name: size})


def test_the_last_row_of_the_matrix_may_be_missing():
    entry = camera_to_json(CAMERA)
    short = camera_from_json({**entry, "transform_matrix": entry["transform_matrix"][:3]})
    assert short == camera_from_json(entry)


@pytest.mark.parametrize(
    ("matrix", "said"),
    [
        (list(range(16)), "is 16; must be 4 x 4"),
        (np.eye(3).tolist(), "is 3 x 3; must be 4 x 4"),
        ([[1, 0, 0, 0]] * 5, "is 5 x 4; must be 4 x 4"),
        (1.0, "is a single number; must be 4 x 4"),
        ([[1, 0], [0]], "is not a matrix of numbers"),
        ([["a", 0, 0, 0]] * 4, "is not a matrix of numbers"),
    ],
)
def test_a_matrix_of_another_shape_is_refused_by_name(matrix, said):
    with pytest.raises(ValueError, match=f"^transform_matrix {said}"):
        camera_from_json({**camera_to_json(CAMERA), "transform_matrix": matrix})


@pytest.mark.parametrize("name", ["w", "h", "fl_x", "fl_y", "cx", "cy", "transform_matrix"])
def test_a_missing_name_is_reported(name):
    entry = camera_to_json(CAMERA)
    del entry[name]
    with pytest.raises(KeyError, match=name):
        camera_from_json(entry)


def test_an_intrinsic_that_is_not_a_number_is_refused():
    with pytest.raises(TypeError):
        camera_from_json({**camera_to_json(CAMERA), "fl_x": None})
