"""Times of frames, and paths of the gaze."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from hybrid.measure.frame_times import (
    REACH,
    covered,
    gaze_path,
    interleaved_passes,
    jittered_view,
    percentiles,
    reach_for,
)
from hybrid.preparation.scene_plan import as_planned
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest


def test_percentiles_are_interpolated_and_named():
    assert percentiles([5.0, 1.0, 3.0, 2.0, 4.0]) == {"p50": 3.0, "p95": pytest.approx(4.8)}
    assert percentiles([7.0], (99,)) == {"p99": 7.0}


def test_a_gaze_path_is_closed_and_stays_within_reach():
    path = gaze_path(200, (0.1, 0.3))
    x, y = np.array([[gaze.x, gaze.y] for gaze in path]).T
    np.testing.assert_allclose([x.min(), x.max()], [0.4, 0.6], atol=1e-3)
    np.testing.assert_allclose([y.min(), y.max()], [0.2, 0.8], atol=1e-3)
    steps = np.hypot(np.diff(x, append=x[0]), np.diff(y, append=y[0]))
    assert 0 < steps.min() <= steps.max() < 0.03
    assert [(gaze.x, gaze.y) for gaze in gaze_path(3, (0, 0))] == [(0.5, 0.5)] * 3
    assert max(abs(gaze.x - 0.5) for gaze in gaze_path(200)) == pytest.approx(REACH[0], abs=1e-3)


def test_methods_take_turns_and_the_warm_up_does_not_count():
    calls: list[tuple[str, Gaze, int]] = []

    def method(name: str):
        def frame(gaze: Gaze, seed: int) -> dict[str, float]:
            calls.append((name, gaze, seed))
            return {"total": float(seed)}

        return frame

    done: list[tuple[int, int]] = []
    found = interleaved_passes([method("a"), method("b")], 3, 2, lambda *step: done.append(step), (0.1, 0.1))
    assert [(name, seed) for name, _, seed in calls] == [(n, s) for s in range(5) for n in "ab"]
    assert found == [[{"total": 2.0}, {"total": 3.0}, {"total": 4.0}]] * 2
    path = gaze_path(3, (0.1, 0.1))
    # The warm-up takes the last steps of the path.
    assert [gaze for name, gaze, _ in calls if name == "a"] == [path[1], path[2], *path]
    assert done == [(number, 5) for number in range(1, 6)]


@pytest.mark.usefixtures("backend", "own_home")
class TestJitter:
    @pytest.fixture
    def renderer(self, made):
        return Renderer(as_planned(load_scene("cornell")), load_forest(made / "box.forest"))

    def test_jittered_cameras_differ_by_less_than_can_be_seen(self, renderer):
        camera = renderer.scene.camera.resized(96, 64)
        cameras = [jittered_view(View(camera), number).camera for number in range(1000)]
        assert len({one.key for one in [camera, *cameras]}) == 1001
        assert jittered_view(View(camera), 1000).camera.key == cameras[0].key
        points = camera.position + 3 * camera.rays(camera.pixel_centres())
        for one in (cameras[0], cameras[-1]):
            assert np.abs(one.project(points)[0] - camera.project(points)[0]).max() < 0.01
            np.testing.assert_allclose(one.position, camera.position, atol=1e-12)
            rotation = one.world_to_camera[:3, :3]
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        frames = [renderer.frame(FrameSettings(spp=1, camera=one)).composite for one in (camera, cameras[-1])]
        assert np.abs(frames[0] - frames[1]).mean() < 0.01 * frames[0].mean()

    def test_jittered_cameras_need_no_kernels_of_their_own(self, renderer):
        camera = renderer.scene.camera.resized(96, 64)

        def kernels(numbers: range) -> set[str]:
            with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
                dr.kernel_history_clear()
                for number in numbers:
                    renderer.frame(FrameSettings(spp=1, camera=jittered_view(View(camera), number).camera))
                return {entry["hash"] for entry in dr.kernel_history() if "hash" in entry}

        known = kernels(range(8))
        assert len(known) > 10
        # A few settle late, whatever the camera. One that depended on it would be another for each of ten.
        assert len(kernels(range(8, 18)) - known) < 5


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
