"""Pieces of what deforms: where they bring its vertices, and how many there are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pathtrace.scene.courses import courses_of_pieces
from tests.extremes import extreme

TIMES = np.linspace(0, 1, 5)


def sheet(side: int = 20) -> np.ndarray:
    """(side^2, 3) vertices of a square of length 2 in the plane z = 0."""
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    return np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], axis=1)


def waves(rest: np.ndarray, height: float) -> np.ndarray:
    """(T, V, 3) the sheet with waves that run along x."""
    return np.stack([rest + [0, 0, 1] * (height * np.sin(4 * rest[:, :1] + 6 * t)) for t in TIMES])


def test_what_moves_rigidly_is_one_piece():
    rest = sheet()
    turns = [Rotation.from_rotvec([0.3 * t, -t, 0.5 * t]) for t in TIMES]
    moved = np.stack(
        [turn.apply(rest) + np.array([t, 0, 2 * t]) for turn, t in zip(turns, TIMES, strict=True)]
    )
    (course,) = courses_of_pieces("sheet", 3, rest, moved)
    assert (course.name, course.shape) == ("sheet", 3)
    for number, turn in enumerate(turns):
        found = Rotation.from_quat(course.rotations[number, [1, 2, 3, 0]])
        np.testing.assert_allclose((found.inv() * turn).magnitude(), 0, atol=1e-6)
        place = found.apply(rest - course.centre) + course.centre + course.shifts[number]
        np.testing.assert_allclose(place, moved[number], atol=1e-9)


def test_more_bending_takes_more_pieces():
    rest = sheet()
    counts = [len(courses_of_pieces("sheet", 0, rest, waves(rest, height))) for height in (0, 0.05, 0.4)]
    assert counts[0] == 1
    assert 1 < counts[1] < counts[2]


def test_pieces_lie_on_the_surface_at_all_times():
    rest = sheet()
    moved = waves(rest, 0.4)
    for course in courses_of_pieces("sheet", 0, rest, moved):
        vertex = int(np.argmin(np.linalg.norm(rest - course.centre, axis=1)))
        np.testing.assert_allclose(course.centre + course.shifts, moved[:, vertex], atol=1e-9)
        # No piece is its mirror image: normals of a sheet point up.
        up = Rotation.from_quat(course.rotations[:, [1, 2, 3, 0]]).apply([0, 0, 1])
        assert (up[:, 2] > 0).all()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_shape_of_few_vertices_has_no_more_pieces_than_those(count):
    rest = sheet()[:count]
    moved = rest + small_shifts(count)
    courses = courses_of_pieces("few", 0, rest, moved)
    assert 1 <= len(courses) <= count
    assert all(np.isfinite(course.rotations).all() for course in courses)


@extreme(
    "a sheet that collapses to a point and back",
    given="all vertices in one place at half time",
    expected="finite pieces, where the vertices are",
)
def test_a_sheet_may_vanish(got):
    rest = sheet()
    moved = np.stack([rest * (2 * t - 1) for t in TIMES])
    courses = courses_of_pieces("sheet", 0, rest, moved)
    assert all(np.isfinite(course.rotations).all() for course in courses)
    assert got(max(float(np.abs(c.centre + c.shifts[2]).max()) for c in courses), ".1e") < 1e-9


def small_shifts(count: int) -> np.ndarray:
    return np.random.default_rng(0).normal(0, 0.3, (len(TIMES), count, 3))
