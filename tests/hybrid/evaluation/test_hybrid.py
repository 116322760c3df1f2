"""Hybrid frames as a method among others."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from hybrid.evaluation.methods import HybridMethod, Method
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from tests import small
from tests.hybrid.forests import rough_forest

pytestmark = pytest.mark.usefixtures("backend")
GAZE = Gaze(0.3, 0.6)


@pytest.fixture(scope="module")
def renderer(backend) -> Renderer:
    scene = load_scene(small.corner())
    return Renderer(scene, rough_forest(scene))


def test_a_frame_is_that_of_the_renderer_at_the_asked_view(renderer):
    settings = FrameSettings(gaze=(0.9, 0.9), spp=2, fovea="denoised")
    camera = renderer.scene.camera.resized(48, 40)
    method: Method = HybridMethod(renderer, settings)
    made = method.render(View(camera), GAZE, 7)
    expected = renderer.frame(replace(settings, gaze=GAZE, camera=camera), 7)
    np.testing.assert_array_equal(made.image, expected.composite)
    assert made.milliseconds.keys() == expected.milliseconds.keys()
    assert made.milliseconds["total"] > 0


def test_rays_are_the_samples_in_the_disc_over_the_pixels_of_the_frame(renderer):
    """A disc of 16 of 64 pixels radius covers pi / 16; in the band of a raw one rays thin out to none."""
    camera = renderer.scene.camera.resized(64, 64)
    fused = HybridMethod(renderer, FrameSettings(fov_a=25, fov_b=25, spp=3))
    assert fused.rays(camera, Gaze()) == pytest.approx(3 * np.pi / 16, rel=0.02)
    wide = HybridMethod(renderer, FrameSettings(fov_a=25, fov_b=0, spp=3, fovea="raw"))
    # The weight falls linearly from the centre: a cone, a third of the cylinder.
    assert wide.rays(camera, Gaze()) == pytest.approx(np.pi / 16, rel=0.02)
    # Half of the disc lies outside.
    assert fused.rays(camera, Gaze(0, 0.5)) == pytest.approx(1.5 * np.pi / 16, rel=0.02)


def test_settings_are_json(renderer):
    method = HybridMethod(renderer, FrameSettings(fov_a=30, fov_b=10, spp=2))
    assert json.loads(json.dumps(method.settings)) == {"fovea": "fused", "spp": 2, "fov_a": 30, "fov_b": 10}
