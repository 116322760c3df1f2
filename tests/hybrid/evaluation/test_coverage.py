"""A moving gaze does not flatter large discs."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import Camera
from hybrid.measure.frame_times import REACH, covered, reach_for


def camera(width: int, height: int) -> Camera:
    return Camera(np.eye(4), width, height, height, height, width / 2, height / 2)


@pytest.mark.parametrize("size", [(640, 390), (506, 530), (829, 265), (265, 530)])
def test_discs_cover_along_the_path_what_they_cover_in_the_middle(size):
    frame = camera(*size)
    for radius in range(10, 100, 10):
        along = covered(radius, frame, 15, reach_for(radius, frame))
        assert along == pytest.approx(covered(radius, frame, 1, (0, 0)), rel=0.006)
    # What the default path would lose: the test can tell.
    assert covered(80, camera(506, 530), 15, REACH) < covered(80, camera(506, 530), 1, (0, 0)) - 0.001
    assert covered(60, camera(506, 530), 15, REACH) < 0.91


def test_each_axis_has_its_own_reach():
    """In a wide frame there is room to the sides where there is none above and below."""
    across, down = reach_for(60, camera(829, 265))
    assert across == REACH[0]
    assert 0 < down <= 0.02
    assert reach_for(20, camera(829, 265)) == REACH
    narrow = reach_for(20, camera(265, 530))
    assert narrow == pytest.approx((0.1, REACH[1]))
