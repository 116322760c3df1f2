"""A way through views."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import View
from hybrid.render.video import ViewPath
from tests import posed


def test_it_passes_each_view_at_its_time():
    views = [View(posed.camera(number), time) for number, time in enumerate((0.0, 0.2, 1.0))]
    path = ViewPath(views)
    for share, view in zip((0, 0.5, 1), views, strict=True):
        camera, found, shown = view.camera, path.at(share).camera, path.at(share).time
        assert np.allclose(found.world_to_camera, camera.world_to_camera, atol=1e-12)
        assert (found.fx, found.cx) == pytest.approx((camera.fx, camera.cx))
        assert shown == pytest.approx(view.time)


def test_between_views_it_goes_straight_and_turns_evenly():
    a, b = posed.camera(0), posed.camera(1)
    between = ViewPath([View(a, 0.4), View(b, 0.6)]).at(0.5)
    found = between.camera
    assert found.position == pytest.approx((a.position + b.position) / 2)
    assert between.time == pytest.approx(0.5)
    axes = [camera.world_to_camera[2, :3] for camera in (a, found, b)]
    assert axes[0] @ axes[1] == pytest.approx(axes[1] @ axes[2])


def test_all_frames_have_the_size_of_the_first():
    views = [View(posed.camera(0, 40, 30), 0), View(posed.camera(1, 80, 60), 1)]
    found = ViewPath(views).at(1).camera
    assert (found.width, found.height, found.fx) == (40, 30, pytest.approx(posed.FOCAL * 40 / posed.WIDTH))


def test_a_single_view_stays_where_it_is():
    path = ViewPath([View(posed.camera(2), 0.3)])
    for share in (0, 0.7, 1):
        found = path.at(share)
        assert np.allclose(found.camera.world_to_camera, posed.camera(2).world_to_camera, atol=1e-12)
        assert found.time == pytest.approx(0.3)
