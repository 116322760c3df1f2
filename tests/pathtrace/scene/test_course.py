"""Courses of shapes that move rigidly."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from pathtrace.scene.courses import course_from_json, course_of_poses
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
