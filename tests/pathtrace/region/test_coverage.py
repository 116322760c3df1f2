"""What views cover, where it is known: a wall from near, from afar, at a slant, behind a screen."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest

from compose.camera.camera import Camera, camera_from_pose, look_at
from pathtrace.region.view_coverage import ViewCoverage
from pathtrace.scene.scene import load_scene
from pathtrace.scene.triangles import Surfaces
from tests.pathtrace.region import boxes

pytestmark = pytest.mark.usefixtures("backend")


@pytest.fixture(scope="module")
def wall(backend) -> Surfaces:
    """A wall of 20 by 20 at z = 0, and a screen of 1 by 1 before it at z = 1, x = 8."""
    placed = mi.ScalarTransform4f().translate([8, 0, 1]).scale(0.5)
    description = {
        "type": "scene",
        "sensor": boxes.camera([0, 0, 4], [0, 0, 0]),
        "wall": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(10)},
        "screen": {"type": "rectangle", "to_world": placed},
        "lamp": {"type": "point", "position": [0, 0, 5]},
    }
    return load_scene(description).surfaces()


def at(position: list[float], target: list[float], size: int = 32) -> Camera:
    """A camera of 2 x 26.6 degrees."""
    pose = look_at(np.array(position, float), np.array(target, float), np.array([0, 1.0, 0]))
    return camera_from_pose(pose, size, size, size, size, size / 2, size / 2)


def test_a_view_covers_what_it_sees_itself(wall):
    view = at([0, 0, 4], [0, 0, 0])
    coverage = ViewCoverage(wall, [view])
    found = coverage.map(view)
    assert found.shape == (12, 12)
    np.testing.assert_allclose(found, 1)
    assert coverage.share(view) == 1
    assert coverage.map(replace(view, width=64, cx=32.0)).shape == (8, 18)


def test_nothing_covers_nothing(wall):
    assert ViewCoverage(wall, []).share(at([0, 0, 4], [0, 0, 0])) == 0


@pytest.mark.parametrize(("away", "expected"), [(2.0, 1.0), (4.0, 1.0), (8.0, 0.5), (16.0, 0.25)])
def test_resolution_is_that_of_the_distance(wall, away, expected):
    """Whatever the number of pixels of either."""
    coverage = ViewCoverage(wall, [at([0, 0, away], [0, 0, 0], size=8)])
    centre = coverage.map(at([0, 0, 4], [0, 0, 0], size=64))[5:7, 5:7]
    np.testing.assert_allclose(centre, expected, rtol=0.02)


def test_half_of_a_frame_that_another_does_not_show_is_uncovered(wall):
    coverage = ViewCoverage(wall, [at([2, 0, 4], [2, 0, 0])])
    found = coverage.map(at([0, 0, 4], [0, 0, 0]))
    # From above, x points to the right as seen against z.
    assert (found > 0).mean() == 0.5
    assert (found[:, 6:] > 0).all()
    coverage.add([at([-2, 0, 4], [-2, 0, 0])])
    assert (coverage.map(at([0, 0, 4], [0, 0, 0])) > 0).all()


def test_what_is_hidden_or_seen_from_behind_is_uncovered(wall):
    looking = at([8.0, 0, 0.9], [8, 0, 0])
    hidden = ViewCoverage(wall, [at([8, 0, 4], [8, 0, 0])])
    assert hidden.share(looking) == 0
    behind = ViewCoverage(wall, [at([0, 0, -4], [0, 0, 0])])
    assert behind.share(at([0, 0, 4], [0, 0, 0])) == 0


def test_a_slant_counts(wall):
    """At 60 degrees from the normal and the same distance, one axis keeps its resolution, one has half."""
    slanted = at([4 * np.sin(np.pi / 3), 0, 4 * np.cos(np.pi / 3)], [0, 0, 0])
    found = ViewCoverage(wall, [slanted]).map(at([0, 0, 4], [0, 0, 0]))[5:7, 5:7]
    np.testing.assert_allclose(found, np.sqrt(0.5), rtol=0.08)


def test_the_sky_is_covered_by_direction(wall):
    """From anywhere, but not where a surface hides it."""
    up = at([0, 0, 4], [0, 0.01, 9])
    assert ViewCoverage(wall, [at([3, 1, 6], [3, 1.01, 11])]).share(up) > 0.98
    assert ViewCoverage(wall, [at([3, 1, -6], [3, 1.01, -1])]).share(up) == 0
