"""Frames that are warped to the newest camera just before they are shown."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from compose.camera.camera import Camera, turned
from compose.eye.gaze import Gaze
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.frame_source import SceneSource
from hybrid.window.messages import Request, ShownFrame, ShownView
from hybrid.window.window_views import late_warped

# One that cannot be asked for depths.
NO_TRACER: Any = SimpleNamespace()


def shown_from(source: SceneSource, camera: Camera, **settings: Any) -> ShownFrame:
    """The splats of a view: without noise."""
    base = FrameSettings(gaze=Gaze(0.5, 0.5), fov_a=2.0, fov_b=1.0, spp=1, camera=camera, **settings)
    return source.show(Request(base, ShownView.PERIPHERY), True)


def moved(camera: Camera, right: float = 0.0, degrees: float = 0.0) -> Camera:
    """A camera beside another one, turned to the right."""
    pose = camera.camera_to_world
    pose[:3, 3] += pose[:3, 0] * right
    pose[:3, :3] = turned(pose[:3, :3], degrees, 0.0)
    return camera.at(pose)


def decibels(one: ShownFrame, other: ShownFrame) -> float:
    difference = one.image.astype(np.float64) - other.image
    return float(-10 * np.log10(np.mean((difference / 255) ** 2)))


@pytest.fixture
def camera(source) -> Camera:
    view: Camera = source.camera.resized(160, 120)
    return view


def test_a_frame_of_the_newest_camera_is_shown_as_it_is(source, camera):
    late = shown_from(source, camera)
    assert late_warped(late, replace(camera), NO_TRACER) is late


@pytest.mark.parametrize(("right", "degrees"), [(0.08, 0.0), (0.0, 3.0), (-0.05, 1.5)])
def test_a_late_frame_comes_closer_to_what_is_seen_now(source, camera, right, degrees):
    newest = moved(camera, right * source.ready().distance, degrees)
    late = shown_from(source, camera)
    warped = late_warped(late, newest, source.renderer.tracer)
    expected = shown_from(source, newest)
    assert decibels(warped, expected) > decibels(late, expected) + 4


def test_the_warp_is_a_pass_of_the_frame(source, camera):
    late = shown_from(source, camera)
    warped = late_warped(late, moved(camera, degrees=2.0), NO_TRACER)
    assert (warped.image.dtype, warped.image.shape) == (np.uint8, (120, 160, 3))
    assert [*warped.milliseconds][-2:] == ["warp", "total"]
    added = warped.milliseconds["total"] - late.milliseconds["total"]
    assert added == pytest.approx(warped.milliseconds["warp"])
    assert {**late.milliseconds, **warped.milliseconds} == warped.milliseconds
    assert replace(warped, image=late.image, milliseconds=late.milliseconds) == late


def test_a_frame_of_half_the_size_keeps_it(source, camera):
    late, newest = shown_from(source, camera, scale=0.5), moved(camera, degrees=3.0)
    assert late.image.shape == (60, 80, 3)
    warped, expected = late_warped(late, newest, NO_TRACER), shown_from(source, newest, scale=0.5)
    assert decibels(warped, expected) > decibels(late, expected) + 4
