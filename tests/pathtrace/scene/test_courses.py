"""Courses of shapes that move rigidly, and which turns of which meshes nobody sees."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pathtrace.scene.courses import course_from_json, course_of_poses, is_unchanged
from pathtrace.scene.motion_file import Keyframe, RigidTrack

TRACK = RigidTrack((Keyframe(0.0), Keyframe(1.0, (1.0, 2.0, 0.0), 300.0)), (0.0, 0.6, 0.8), (0.5, 0.0, 1.0))
TIMES = np.linspace(0, 1, 9)
POSES = np.stack([TRACK.pose(time) for time in TIMES])
COURSE = course_of_poses("door", 3, POSES, np.array(TRACK.about))


def test_a_course_holds_its_poses():
    w, x, y, z = COURSE.rotations.T
    np.testing.assert_allclose(w**2 + x**2 + y**2 + z**2, 1)
    trace = POSES[:, :3, :3].trace(axis1=1, axis2=2)
    np.testing.assert_allclose(4 * w**2 - 1, trace, atol=1e-12)
    np.testing.assert_allclose(COURSE.shifts, TIMES[:, None] * [1, 2, 0], atol=1e-12)


def test_a_course_comes_back_from_json():
    back = course_from_json(json.loads(json.dumps(COURSE.as_json())))
    assert (back.name, back.shape) == ("door", 3)
    for name in ("rotations", "centre", "shifts"):
        np.testing.assert_allclose(getattr(back, name), getattr(COURSE, name), atol=1e-15)


@pytest.mark.parametrize(
    "change",
    [
        {"rotations": [[1, 0, 0, 0]]},
        {"rotations": [[1, 0, 0]] * 9},
        {"rotations": [[2, 0, 0, 0]] * 9},
        {"shifts": [[0, 0, 0]] * 8},
        {"shifts": [[0, 0, float("inf")]] * 9},
        {"centre": [0, 0]},
        {"centre": "here"},
        {"shape": "first"},
    ],
)
def test_what_is_no_course_is_refused(change: dict[str, Any]):
    with pytest.raises((ValueError, TypeError)):
        course_from_json({**COURSE.as_json(), **change})


CENTRE = np.array([0.3, -0.2, 1.0])


def mesh(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a shape around the centre; of a cylinder and a prism, around the z axis."""
    if kind == "ball":
        u, v = np.meshgrid(np.linspace(0, np.pi, 25), np.linspace(0, 2 * np.pi, 41)[:-1], indexing="ij")
        points = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1).reshape(-1, 3)
        return points + CENTRE, grid(25, 40)
    sides = {"cylinder": 40, "prism": 6}[kind]
    angle = np.linspace(0, 2 * np.pi, sides + 1)[:-1]
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-0.5, 0.5)])
    return points + CENTRE, grid(2, sides)


def grid(rows: int, columns: int) -> np.ndarray:
    """(F, 3) faces between rows of vertices that close in circles."""
    faces = []
    for row in range(rows - 1):
        for column in range(columns):
            a, b = row * columns + column, row * columns + (column + 1) % columns
            faces += [[a, b, a + columns], [b, b + columns, a + columns]]
    return np.array(faces)


def turns(axis: list[float], most: float = 360.0) -> np.ndarray:
    angles = np.radians(np.linspace(0, most, 50))[:, None]
    return Rotation.from_rotvec(angles * np.array(axis) / np.linalg.norm(axis)).as_matrix()


@pytest.mark.parametrize(
    ("kind", "axis", "unchanged"),
    [
        ("ball", [0, 0, 1], True),
        ("ball", [1, 2, 3], True),
        ("cylinder", [0, 0, 1], True),
        ("cylinder", [0, 1, 0], False),
        ("prism", [0, 0, 1], False),
    ],
)
def test_turns_around_an_axis_of_symmetry_are_not_seen(kind, axis, unchanged):
    vertices, faces = mesh(kind)
    assert is_unchanged(vertices, faces, CENTRE, turns(axis)) is unchanged


def test_a_ball_that_turns_around_a_point_beside_it_goes_elsewhere():
    vertices, faces = mesh("ball")
    assert not is_unchanged(vertices, faces, CENTRE + np.array([0.3, 0, 0]), turns([0, 0, 1]))


@pytest.mark.parametrize("kind", ["ball", "cylinder", "prism"])
def test_what_does_not_turn_is_unchanged(kind):
    assert is_unchanged(*mesh(kind), CENTRE, np.tile(np.eye(3), (5, 1, 1)))


def test_a_mesh_without_area_is_compared_by_its_vertices():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert not is_unchanged(line, np.array([[0, 1, 2]]), np.zeros(3), turns([0, 0, 1]))
    assert is_unchanged(line, np.array([[0, 1, 2]]), np.zeros(3), turns([1, 0, 0]))
