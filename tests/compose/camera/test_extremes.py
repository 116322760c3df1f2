"""Cameras that are no cameras, and coordinates far from the world's."""

from __future__ import annotations

import json
from collections.abc import Callable
from decimal import Decimal, getcontext

import numpy as np
import pytest

from compose.camera.camera import Camera, camera_from_pose, look_at
from compose.camera.coordinate_systems import Place, camera_from_json, camera_to_json
from tests.extremes import extreme


def pose(seed: int = 0) -> np.ndarray:
    """(4, 4) camera-to-world."""
    rng = np.random.default_rng(seed)
    return look_at(rng.normal(size=3), rng.normal(size=3), rng.normal(size=3))


def scaled(matrix: np.ndarray) -> np.ndarray:
    matrix[:3, :3] *= 1.001
    return matrix


def sheared(matrix: np.ndarray) -> np.ndarray:
    turned = matrix[:3, 0] + 1e-3 * matrix[:3, 1]
    matrix[:3, 0] = turned / np.linalg.norm(turned)
    return matrix


def mirrored(matrix: np.ndarray) -> np.ndarray:
    matrix[:3, 0] *= -1
    return matrix


def not_a_number(matrix: np.ndarray) -> np.ndarray:
    matrix[1, 2] = np.nan
    return matrix


def infinite(matrix: np.ndarray) -> np.ndarray:
    matrix[0, 3] = np.inf
    return matrix


def zero(matrix: np.ndarray) -> np.ndarray:
    return matrix * 0


def projective(matrix: np.ndarray) -> np.ndarray:
    matrix[3, 0] = 0.5
    return matrix


def case(spoil: Callable[[np.ndarray], np.ndarray], given: str, message: str) -> object:
    name = f"pose {spoil.__name__.replace('_', ' ')}"
    return pytest.param(spoil, message, marks=extreme(name, given=given, expected="refused in one line"))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        case(scaled, "axes of length 1.001", "axes have the lengths 1.001"),
        case(sheared, "two axes 0.06 degrees off a right angle", "scalar products up to 0.001"),
        case(mirrored, "determinant -1", "it mirrors"),
        case(not_a_number, "NaN in the rotation", "not finite"),
        case(infinite, "infinite position", "not finite"),
        case(zero, "all zeros", "axes have the lengths 0, 0, 0"),
        case(projective, "last row 0.5 0 0 1", "last row"),
    ],
)
def test_poses_that_are_not_rigid_are_refused(spoil, message, got):
    with pytest.raises(ValueError, match=message) as caught:
        Camera(spoil(pose()), 64, 48, 50, 50, 32, 24)
    assert "\n" not in got(str(caught.value))
    with pytest.raises(ValueError, match=r"pose|finite"):
        camera_from_pose(spoil(pose()), 64, 48, 50, 50, 32, 24)
    entry = camera_to_json(camera_from_pose(pose(), 64, 48, 50, 50, 32, 24))
    entry["transform_matrix"] = spoil(np.array(entry["transform_matrix"])).tolist()
    with pytest.raises(ValueError, match=r"pose|finite"):
        camera_from_json(json.loads(json.dumps(entry)))


@extreme(
    "poses of other programs",
    given="1,000 random rotations with 5 decimals, or in float32",
    expected="accepted",
)
def test_rounded_poses_are_accepted(got):
    accepted = 0
    for seed in range(500):
        for rounded in (pose(seed).round(5), pose(seed).astype(np.float32).astype(np.float64)):
            camera_from_pose(rounded, 64, 48, 50, 50, 32, 24)
            accepted += 1
    assert got(accepted) == 1000


@pytest.mark.parametrize(
    ("distance", "unit"),
    [
        pytest.param(d, u, marks=extreme(name, given=given, expected="within 1e-6 px of 50 decimals"))
        for d, u, name, given in [
            (1e6, 1.0, "camera moved by 1e6", "coordinates with the origin 1e6 away"),
            (0.0, 1e-4, "camera in a unit of 1e-4", "scene of 1e-4 in its own coordinates"),
            (1e6, 1e6, "camera in a unit of 1e6", "scene of 1e6, as far from the origin"),
        ]
    ],
)
def test_own_coordinates_keep_every_pixel(distance, unit, got):
    """A point is projected from its own coordinates in float64, and from the world's in 50 decimals."""
    getcontext().prec = 50
    origin = np.array([0.7, -0.5, 0.3]) * distance
    eye = look_at(np.array([0.1, 0.2, -3.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    eye[:3, 3] = eye[:3, 3] * unit + origin
    world = camera_from_pose(eye, 64, 48, 500, 500, 32, 24)
    own = Place((origin[0], origin[1], origin[2]), unit).camera(world)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))
    pixels, _ = own.project(points)
    worst = 0.0
    for point, pixel in zip(points, pixels, strict=True):
        parts = zip(point, origin, eye[:3, 3], strict=True)
        offset = [Decimal(p) * Decimal(unit) + Decimal(o) - Decimal(e) for p, o, e in parts]
        x, y, z = (sum(Decimal(eye[i, axis]) * offset[i] for i in range(3)) for axis in range(3))
        exact = float(500 * x / z + 32), float(500 * y / z + 24)
        worst = max(worst, float(np.abs(pixel - exact).max()))
    assert got(worst, ".1e") < 1e-6


@pytest.mark.parametrize(
    ("target", "up"),
    [
        pytest.param(t, u, marks=extreme(n, given=g, expected="refused in one line"))
        for t, u, n, g in [
            ([1.0, 2, 3], [0.0, 1, 0], "looking at oneself", "position and target are the same"),
            ([1.0, 9, 3], [0.0, 1, 0], "looking straight up", "up along the direction of sight"),
            ([1.0, np.nan, 3], [0.0, 1, 0], "looking at NaN", "NaN in the target"),
        ]
    ],
)
def test_directions_that_are_none_are_refused(target, up, got):
    with pytest.raises(ValueError, match="no direction from") as caught:
        look_at(np.array([1.0, 2.0, 3.0]), np.array(target), np.array(up))
    assert "\n" not in got(str(caught.value))
