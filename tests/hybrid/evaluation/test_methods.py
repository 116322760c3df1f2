"""Methods of rendering a frame."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.base.compute_device import device_arrays
from hybrid.evaluation.baselines_disc import DiscOverEnlarged
from hybrid.evaluation.baselines_guided import Guided
from hybrid.evaluation.baselines_traced import Enlarged, FullTrace
from hybrid.evaluation.baselines_warped import Rmfr
from hybrid.evaluation.methods import HybridMethod, Method, SplatsAlone
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery
from pathtrace.region.neighbourhood import unseen_views, view_time
from pathtrace.scene.scene import Scene, load_scene
from splat.model.forest import Forest
from tests import small
from tests.hybrid.forests import moving_forest, rough_forest
from tests.moving import moving_corner

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


def test_the_finest_layer_is_shown_at_full_rate_whatever_the_gaze(arrays):
    scene = load_scene(small.corner())
    forest = rough_forest(scene)
    periphery = Periphery(arrays, forest)
    method: Method = SplatsAlone(periphery)
    one, other = (method.render(View(scene.camera), gaze, 0) for gaze in (Gaze(), Gaze(0.1, 0.1)))
    np.testing.assert_array_equal(one.image, other.image)
    finest = FrameSettings(layers=(3, 3))
    np.testing.assert_array_equal(one.image, periphery.whole(scene.camera, finest).numpy())
    coarsest = periphery.whole(scene.camera, FrameSettings(layers=(1, 1))).numpy()
    assert np.abs(one.image - coarsest).max() > 0.05
    assert set(one.milliseconds) == {"splat", "total"}


def test_no_rays_are_traced_and_the_finest_layer_is_counted(arrays):
    scene = load_scene(small.corner())
    forest = rough_forest(scene)
    method = SplatsAlone(Periphery(arrays, forest))
    assert method.rays(scene.camera, Gaze()) == 0
    assert method.settings == {"gaussians": forest.counts[-1]}
    assert forest.counts[-1] == max(forest.counts)


METHODS = ("hybrid", "splats", "full", "enlarged", "guided", "disc", "rmfr")


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
        "enlarged": Enlarged(renderer.tracer, 8, True, 1.0),
        "guided": Guided(renderer.tracer, 8, True, 1.0, True, True),
        "disc": DiscOverEnlarged(renderer.tracer, 8, True, Foveation(Gaze()), 8.0, 0.5),
        "rmfr": Rmfr(renderer.tracer, 8, True, 0.4, 1.5),
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
