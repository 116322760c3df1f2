"""Methods show a view's time."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from hybrid.base.compute_device import device_arrays
from hybrid.evaluation.methods import Enlarged, FullTrace, HybridMethod, Method, Rmfr, SplatsAlone
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery
from pathtrace.region.neighbourhood import unseen_views, view_time
from pathtrace.scene.scene import Scene, load_scene
from splat.model.forest import Forest
from tests import small
from tests.hybrid.forests import moving_forest
from tests.moving import moving_corner

METHODS = ("hybrid", "splats", "full", "enlarged", "rmfr")


@pytest.fixture(scope="module")
def scene(backend, tmp_path_factory) -> Scene:
    return moving_corner(tmp_path_factory.mktemp("moving"))


@pytest.fixture(scope="module")
def forest(scene) -> Forest:
    return moving_forest(scene)


def method_of(name: str, scene: Scene, forest: Forest) -> Method:
    renderer = Renderer(scene, forest)
    return {
        "hybrid": HybridMethod(renderer, FrameSettings(fovea="denoised", spp=2)),
        "splats": SplatsAlone(Periphery(device_arrays(), forest)),
        "full": FullTrace(renderer.tracer, 8, denoised=True),
        "enlarged": Enlarged(renderer.tracer, 1.0, 8, denoised=True),
        "rmfr": Rmfr(renderer.tracer, 0.4, 1.5, 8, denoised=True),
    }[name]


@pytest.mark.parametrize("name", METHODS)
def test_each_method_shows_the_time_of_its_view(scene, forest, name):
    """Whatever the scene showed before."""
    method, camera = method_of(name, scene, forest), scene.camera.resized(64, 64)
    images = {}
    for time in (0.0, 0.9, 0.0):
        made = method.render(View(camera, time), Gaze(), 3).image
        if time in images:
            np.testing.assert_allclose(made, images[time], atol=1e-6)
        images[time] = made
    assert np.abs(images[0.0] - images[0.9]).max() > 0.05


def test_views_to_measure_on_have_times_between_those_of_training(scene):
    views = unseen_views(scene, 5, 32, 32)
    assert [view.time for view in views] == [view_time(scene, number + 0.5) for number in range(5)]
    trained = [view_time(scene, number) for number in range(200)]
    assert min(abs(view.time - time) for view in views for time in trained) > 1e-4
    still = load_scene(small.corner())
    assert [view.time for view in unseen_views(still, 3, 32, 32)] == [0, 0, 0]
