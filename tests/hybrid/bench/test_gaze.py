"""Where the gaze goes while the periphery is watched."""

from __future__ import annotations

import pytest

from compose.base.errors import UserError
from compose.eye.display import Display
from hybrid.bench.gaze import gazes_across

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
