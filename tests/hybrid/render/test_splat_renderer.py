"""Frames of a forest without its scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.splat_renderer import SplatRenderer


@pytest.fixture(scope="module")
def alone(forest) -> SplatRenderer:
    return SplatRenderer(forest)


def test_they_are_the_splats_of_hybrid_frames(alone, renderer, scene):
    settings = FrameSettings(gaze=(-3.0, 0.5), fov_a=0, fov_b=0, camera=scene.camera, aovs=("splat",))
    frame = alone.frame(settings)
    camera, periphery = scene.camera, renderer.periphery
    nowhere = settings.foveation.region(camera.width, camera.height)
    detail = periphery.detail(camera, settings)
    assert np.array_equal(frame.composite, periphery.draw(camera, detail, nowhere).numpy())
    assert np.array_equal(frame.aovs()["splat"], renderer.splats(settings))
    assert frame.nodes_drawn > 0
    assert frame.milliseconds["total"] == pytest.approx(sum(frame.milliseconds.values()) / 2)


def test_a_disc_of_the_settings_is_ignored(alone, scene):
    settings = FrameSettings(camera=scene.camera)
    whole = alone.frame(replace(settings, fov_a=0, fov_b=0)).composite
    assert np.array_equal(alone.frame(settings).composite, whole)


def test_scale_makes_frames_smaller(alone, scene):
    frame = alone.frame(FrameSettings(camera=scene.camera, scale=0.5))
    assert frame.composite.shape[:2] == (scene.camera.height // 2, scene.camera.width // 2)


def test_what_cannot_be_rendered_or_saved_is_refused(alone, scene, tmp_path):
    with pytest.raises(UserError, match="a forest alone has none"):
        alone.frame(FrameSettings())
    with pytest.raises(UserError, match="aovs depth: a forest alone"):
        alone.frame(FrameSettings(camera=scene.camera, aovs=("splat", "depth")))
    with pytest.raises(UserError, match="layers 1 9"):
        alone.frame(FrameSettings(camera=scene.camera, layers=(1, 9)))
    with pytest.raises(UserError, match=r"a\.jpg: must end in \.exr or \.png"):
        alone.frame(FrameSettings(camera=scene.camera)).save(tmp_path / "a.jpg")
    assert not list(tmp_path.iterdir())
