"""Where the gaze goes while the periphery is watched."""

from __future__ import annotations

import pytest

from compose.base.errors import UserError
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from hybrid.bench.gaze import bench_gaze, gazes_across
from hybrid.bench.periphery import display_camera
from hybrid.frame.settings import FrameSettings
from pathtrace.scene.scene import load_scene
from tests import small
from tests.hybrid.forests import rough_forest

DISPLAY = Display(100, 100, 60.0)


def test_the_gaze_goes_through_the_centre():
    path = gazes_across(DISPLAY, 20.0, 5.0, 40.0)
    assert len(path) == 9
    assert (path[4].x, path[4].y) == pytest.approx((0.5, 0.5))
    assert path[0].x == pytest.approx(1 - path[-1].x)
    assert 0 < path[0].x < path[1].x


@pytest.mark.parametrize(
    ("fov_b", "step"),
    [
        (200.0, 5.0),
        # Neither disc covers the frame, both together do.
        (65.0, 40.0),
    ],
)
def test_discs_that_leave_nothing_to_compare_are_refused(fov_b, step):
    with pytest.raises(UserError, match=rf"^fov-b {fov_b}: covers the frame"):
        gazes_across(DISPLAY, fov_b, step, 40.0)
    assert gazes_across(DISPLAY, 55.0, step, 40.0)


def test_a_gaze_that_stays_changes_nothing_and_one_that_jumps_does(backend):
    scene = load_scene(small.corner())
    camera, forest, done = display_camera(scene.camera, DISPLAY), rough_forest(scene), []
    settings = FrameSettings(fov_a=20, fov_b=20, display=DISPLAY)
    paths = [Gaze()] * 3, [Gaze(0.2, 0.5), Gaze(0.8, 0.5), Gaze(0.8, 0.5)]
    still, jumping = (
        bench_gaze(forest, camera, settings, path, lambda *step: done.append(step)) for path in paths
    )
    assert [row["acuity_model"] for row in still] == ["fov-gs", "stelacsf", "geisler-perry", "fovvideovdp"]
    assert all(row["change_max"] == row["change_p99_9"] == 0 for row in still)
    assert max(row["change_max"] for row in jumping) > 1
    for row in jumping:
        # One step of two changes something: their median is half of it.
        assert row["median_change_p99_9"] == pytest.approx(row["change_p99_9"] / 2)
        assert row["change_max"] >= row["change_p99_9"]
        assert (row["width"], row["height"], row["layers"]) == (100, 100, list(forest.counts))
    assert done[-1] == (12, 12)
