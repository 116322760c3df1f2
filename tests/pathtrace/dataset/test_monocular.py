"""Captures of one camera, one instant after the other."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.dataset.capture import capture
from pathtrace.dataset.frame_set import CaptureSettings
from pathtrace.region.neighbourhood import Neighbourhood, monocular_views
from pathtrace.scene.scene import Scene, load_scene
from tests import small
from tests.moving import moving_corner

pytestmark = pytest.mark.usefixtures("backend")


def ball(scale: float) -> Scene:
    """In the middle of a closed sphere of radius 3, in which small screens may be close by."""
    description = small.furnace()
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, 1, 0])
    description["sensor"]["to_world"] = look
    for number, x in enumerate((-scale, scale)):
        screen = mi.ScalarTransform4f().translate([x, 0, 0]).rotate([0, 1, 0], 90).scale(0.2)
        description[f"screen{number}"] = {"type": "rectangle", "to_world": screen}
    return load_scene(description)


def test_the_camera_goes_around_and_looks_at_the_same(backend):
    scene = ball(1.0)
    views = monocular_views(scene, scene.surfaces(), 33, 32, 32)
    assert not views.fixed
    assert views.times == [0.0] * 33
    positions = np.stack([view.position for view in views.spread])
    np.testing.assert_allclose(positions[0], positions[-1], atol=1e-9)
    # Neighbouring instants have neighbouring places, a small part of the way apart.
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert steps.max() < 0.2 * np.ptp(positions, axis=0).max()
    ahead = 3 * scene.camera.camera_to_world[:3, 2]
    seen = np.stack([view.project(ahead[None])[0][0] for view in views.spread])
    still = np.stack(
        [scene.camera.resized(32, 32).moved_right(x).project(ahead[None])[0][0] for x in (-0.25, 0.25)]
    )
    assert np.ptp(seen[:, 0]) < np.ptp(still[:, 0])


def test_it_goes_as_far_as_there_is_space(monkeypatch):
    """Where few places are usable it goes less far, and where none are it stands still."""
    scene = ball(1.0)
    surfaces, home = scene.surfaces(), scene.camera.position
    ways = []
    for most in (1.0, 0.1, 0.0):
        monkeypatch.setattr(
            Neighbourhood,
            "is_usable",
            lambda self, view, most=most: np.abs(view.position - home).max() < most * self.radius,
        )
        views = monocular_views(scene, surfaces, 9, 32, 32)
        ways.append(float(np.ptp([view.position for view in views.spread], axis=0).max()))
    assert ways[0] > ways[1] > ways[2] == 0


def test_frames_show_all_times_in_order(tmp_path):
    scene = moving_corner(tmp_path)
    settings = CaptureSettings(8, 2, 24, 24, spp=2, held_out_spp=2, monocular=True)
    frames = capture(scene, tmp_path / "frames", settings, lambda done, total: None)
    times = sorted([entry.time for entry in [*frames.training, *frames.held_out]])
    np.testing.assert_allclose(times, np.linspace(0, 1, 10))
    training = [entry.time for entry in frames.training]
    assert training == sorted(training)
    again = capture(scene, tmp_path / "frames", settings, lambda done, total: None)
    assert [entry.time for entry in again.training] == training
