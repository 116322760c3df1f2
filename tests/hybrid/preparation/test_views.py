"""Views stage by stage, and which of them get more samples."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.preparation import stage_frames as module
from hybrid.preparation.decisions import breadth_of
from hybrid.preparation.stage_frames import stage_views, stated_error, wanted_of
from hybrid.preparation.stages import Stage
from pathtrace.dataset.growing import GrowingFrames, Wanted
from pathtrace.region import region_of
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.tracer import Tracer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")

FIRST = Stage(views=4, scale=1, spp=4, gaussians=100, steps=1)
SECOND = Stage(views=3, scale=4, spp=64, gaussians=100, steps=1)


@pytest.fixture(scope="module")
def scene(backend) -> Scene:
    return load_scene(small.corner())


@pytest.fixture(scope="module")
def region(scene):
    return region_of(scene, scene.surfaces(), "near")


def test_the_default_region_is_as_broad_as_itself(scene, region):
    assert breadth_of(region, scene.surfaces(), 0) == 1.0


def test_views_of_earlier_stages_come_first_and_stay(region):
    both = stage_views(region, [FIRST, SECOND], 3)
    assert [scale for _, scale in both] == [1] * 4 + [4] * 3
    assert both[:4] == stage_views(region, [FIRST], 3)
    assert all(camera.width == camera.height == 256 for camera, _ in both[:4])


def test_views_at_high_resolution_are_parts_of_whole_ones(region):
    whole = region.views(7, 1024, 1024, 3)
    for (camera, _), home in zip(stage_views(region, [FIRST, SECOND], 3)[4:], whole[4:], strict=True):
        assert (camera.width, camera.height) == (512, 512)
        assert camera.fx == pytest.approx(home.fx)
        left, top = home.cx - camera.cx, home.cy - camera.cy
        assert 0 <= left <= 512
        assert 0 <= top <= 512


def test_new_views_get_the_samples_of_their_scale_and_none_are_taken_away(
    scene, region, tmp_path, monkeypatch
):
    monkeypatch.setattr(module, "_SIDE", 32)
    stage = Stage(views=2, scale=1, spp=4, gaussians=100, steps=1)
    views = stage_views(region, [stage], 0)
    frames = GrowingFrames(tmp_path, Tracer(scene), "path", 0)
    assert wanted_of(frames, views, stage, None) == [Wanted(camera, 4) for camera, _ in views]
    cameras = [camera.resized(32, 32) for camera, _ in views]
    frames.grow([Wanted(cameras[0], 8), Wanted(cameras[1], 4)], lambda done, total: None)
    assert [view.spp for view in wanted_of(frames, views, stage, None)] == [8, 4]
    finer = Stage(views=1, scale=4, spp=64, gaussians=100, steps=1)
    # Of coarse views, which hardly matter for the finest layer, no more samples are taken.
    more = wanted_of(frames, stage_views(region, [stage, finer], 0), finer, None)
    assert [view.spp for view in more] == [8, 4, 4]
    assert 5 < stated_error(frames) < 80


def test_the_stated_error_falls_with_samples(scene, region, tmp_path):
    camera = region.views(1, 32, 32, 0)[0]
    errors = []
    for spp in (2, 64):
        frames = GrowingFrames(tmp_path / str(spp), Tracer(scene), "path", 0)
        frames.grow([Wanted(camera, spp)], lambda done, total: None)
        errors.append(stated_error(frames))
    assert np.isfinite(errors).all()
    assert errors[1] > errors[0] + 3
