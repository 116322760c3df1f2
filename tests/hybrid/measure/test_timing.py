"""Cameras for timing: each another, all the same to the eye."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from hybrid.frame.renderer import HybridRenderer
from hybrid.measure.timing import jittered
from hybrid.sweeps.comparison import compare
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest

pytestmark = pytest.mark.usefixtures("backend", "own_home")


@pytest.fixture
def renderer(made):
    return HybridRenderer(load_scene("cornell"), load_forest(made / "box.forest"), mode="fused")


def test_nudged_cameras_differ_by_less_than_can_be_seen(renderer):
    camera = renderer.tracer.scene.camera.resized(96, 64)
    cameras = [jittered(camera, number) for number in range(1000)]
    assert len({one.key for one in [camera, *cameras]}) == 1001
    points = camera.position + 3 * camera.rays(camera.pixel_centres())
    for one in (cameras[0], cameras[-1]):
        assert np.abs(one.project(points)[0] - camera.project(points)[0]).max() < 0.01
        np.testing.assert_allclose(one.position, camera.position, atol=1e-12)
        rotation = one.world_to_camera[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    frames = [renderer.frame(one, Foveation(Gaze())).composite for one in (camera, cameras[-1])]
    assert np.abs(frames[0] - frames[1]).mean() < 0.01 * frames[0].mean()


def test_nudged_cameras_need_no_kernels_of_their_own(renderer):
    camera = renderer.tracer.scene.camera.resized(96, 64)

    def kernels(numbers: range) -> set[str]:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            for number in numbers:
                renderer.frame(jittered(camera, number), Foveation(Gaze()))
            return {entry["hash"] for entry in dr.kernel_history() if "hash" in entry}

    known = kernels(range(8))
    assert len(known) > 10
    # A few settle late, whatever the camera. But what depended on it would be another kernel for each of ten.
    assert len(kernels(range(8, 18)) - known) < 5


def test_each_frame_of_a_comparison_has_a_camera_of_its_own(renderer, monkeypatch):
    asked = []
    for name in ("frame", "path_traced", "disc_alone"):
        make = getattr(renderer, name)
        monkeypatch.setattr(renderer, name, lambda c, *rest, make=make: (asked.append(c.key), make(c, *rest)))
    row = compare(renderer, renderer.tracer.scene.camera.resized(48, 32), 60, 40, 1, 3, 1, lambda *_: None)
    assert len(asked) == len(set(asked)) == 3 * (3 + 1)
    assert row["covered"] == pytest.approx(0.69, abs=0.01)
