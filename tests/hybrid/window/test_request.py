"""Which requests ask for the same frame, and which views need a path-traced one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.messages import Request, ShownView


def camera(x: float = 0.0) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = x
    return Camera(pose, 64, 48, 50.0, 50.0, 32.0, 24.0)


SETTINGS = FrameSettings(gaze=Gaze(0.3, 0.4), camera=camera())
REQUEST = Request(SETTINGS, ShownView.SPLIT, 5.0, 15.0)


def test_the_same_frame_may_be_asked_for_at_another_time_with_an_equal_camera():
    again = Request(replace(SETTINGS, camera=camera()), ShownView.SPLIT, 6.0, 15.0, REQUEST.asked + 1)
    assert again.settings.camera is not SETTINGS.camera
    assert REQUEST.same_frame(again)


@pytest.mark.parametrize(
    "other",
    [
        None,
        replace(REQUEST, view=ShownView.COMPOSITE),
        replace(REQUEST, target_fps=None),
        replace(REQUEST, target_fps=30.0),
        replace(REQUEST, settings=replace(SETTINGS, gaze=Gaze(0.3, 0.41))),
        replace(REQUEST, settings=replace(SETTINGS, spp=5)),
        replace(REQUEST, settings=replace(SETTINGS, camera=camera(0.1))),
        replace(REQUEST, settings=replace(SETTINGS, display="hmd")),
    ],
)
def test_anything_else_is_another_frame(other):
    assert not REQUEST.same_frame(other)


def test_views_come_in_the_order_of_their_keys():
    names = "COMPOSITE FOVEA PERIPHERY PATH_TRACED SPLIT LEVELS DIFFERENCE"
    assert [view.name for view in ShownView] == names.split()


def test_three_views_show_a_path_traced_frame():
    needing = {view for view in ShownView if view.needs_path_traced}
    assert needing == {ShownView.PATH_TRACED, ShownView.SPLIT, ShownView.DIFFERENCE}
