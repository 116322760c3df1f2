"""The hybrid frame: exact at both ends, right in between, and correct in a closed sphere."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hybrid.baselines.methods import Hybrid

from compose.base.errors import UserError
from compose.camera.serialization import camera_from_json, camera_to_json
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from compose.image.colour import srgb_from_radiance
from hybrid.frame.aovs import frame_layers
from hybrid.frame.periphery import Viewing
from hybrid.frame.renderer import HybridRenderer
from hybrid.measure.metrics.psnr import psnr
from hybrid.measure.metrics.registration import registration_px
from hybrid.measure.metrics.ssim import ssim
from hybrid.output.images import read_layers, write_layers
from pathtrace.dataset.rendering import render_frame
from pathtrace.scene.scene import Scene, load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from splat.lod.renderer import ForestRenderer
from splat.model.building import build_forest
from splat.model.forest import Forest
from splat.model.forest import forest_of as forest_from
from splat.model.gaussians import Gaussians
from splat.model.layer import static_layer
from splat.training.initialization import seed_from_views
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.views import TrainingView
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def forest_of(scene: Scene, degree: int = 0) -> Forest:
    """Untrained seeds: a rough picture of the scene, enough to blend with."""
    frame = render_frame(Tracer(scene), scene.camera, 4, 0)
    view = TrainingView(scene.camera, frame.radiance, frame.unfolded, frame.normal)
    gaussians = seed_from_views([view], 500, degree, small.rng())
    layers = build_forest(static_layer(gaussians), 0.05, 3)
    return forest_from(layers, scene.camera.fy, scene.name, scene.hash)


@pytest.fixture(scope="module")
def renderer(backend) -> HybridRenderer:
    scene = load_scene(small.corner())
    return HybridRenderer(scene, forest_of(scene), Viewing(acuity_model="none"))


def test_a_covering_disc_is_the_path_traced_frame_exactly(renderer):
    camera = renderer.tracer.scene.camera
    frame = renderer.frame(camera, Foveation(Gaze(), 500, 10), spp=2, seed=4)
    traced = renderer.path_traced(camera, frame_positions(camera), 2, 4)
    assert np.array_equal(frame.composite, traced)


def test_no_disc_is_the_splat_frame_exactly(renderer):
    camera = renderer.tracer.scene.camera
    frame = renderer.frame(camera, Foveation(Gaze(), 0, 0), spp=2)
    assert np.array_equal(frame.composite, renderer.splat_frame(camera))


@pytest.mark.parametrize("gaze", [Gaze(), Gaze(0, 0), Gaze(1, 1), Gaze(-0.2, 0.4), Gaze(3, 3)])
def test_each_pixel_is_the_weighted_mean_of_both(renderer, gaze):
    camera = renderer.tracer.scene.camera.resized(70, 50)
    frame = renderer.frame(camera, Foveation(gaze, 40, 20), spp=1)
    weight = frame.region.weight_image()[..., None]
    whole = renderer.splat_frame(camera)
    expected = weight * frame.of_disc(frame.fovea.radiance) + (1 - weight) * whole
    np.testing.assert_allclose(frame.composite, expected, atol=1e-5)
    assert np.isfinite(frame.composite).all()


def test_only_the_disc_is_traced_and_hidden_tiles_are_not_rasterized(renderer):
    camera = renderer.tracer.scene.camera.resized(160, 160)
    frame = renderer.frame(camera, Foveation(Gaze(), 45, 40), spp=1)
    assert len(frame.fovea.radiance) == frame.region.weight_image().astype(bool).sum()
    assert (frame.periphery[72:88, 72:88] == 0).all()
    assert (renderer.splat_frame(camera)[72:88, 72:88] > 0).any()


def test_in_the_band_a_raw_disc_has_as_many_samples_as_it_shows(renderer):
    camera, foveation = renderer.tracer.scene.camera.resized(160, 160), Foveation(Gaze(), 45, 20)
    whole = foveation.region(160, 160)
    frame = renderer.frame(camera, foveation, spp=3)
    count = frame.of_disc(frame.fovea.samples.count[:, None])[..., 0]
    assert (count[whole.weight_image() == 1] == 3).all()
    assert np.abs(count - 3 * whole.weight_image()).max() < 1
    paths = Hybrid(renderer, 45, 20, 3).rays(camera, Gaze()) * 160 * 160
    assert count.sum() == pytest.approx(paths, rel=0.01)
    assert paths == pytest.approx(3 * whole.weights.sum())


def test_samples_that_are_remembered_or_denoised_are_taken_everywhere(renderer):
    scene, foveation = renderer.tracer.scene, Foveation(Gaze(), 45, 20)
    camera = scene.camera.resized(48, 48)
    whole = foveation.region(48, 48)
    for mode, remembers in (("raw", True), ("denoised", False)):
        other = HybridRenderer(scene, forest_of(scene), mode=mode, remembers=remembers)
        frame = other.frame(camera, foveation, spp=1)
        np.testing.assert_array_equal(frame.region.weight_image(), whole.weight_image())
        assert (frame.fovea.samples.count == 1).all()
        assert Hybrid(other, 45, 20, 1).rays(camera, Gaze()) == len(whole.pixels) / 48**2


def test_a_denoised_disc_is_closer_to_the_truth(renderer):
    scene = renderer.tracer.scene
    camera = scene.camera.resized(96, 96)
    truth = renderer.path_traced(camera, frame_positions(camera), 1024, 1)
    foveation = Foveation(Gaze(), 60, 55)
    clean = HybridRenderer(scene, forest_of(scene), mode="denoised").frame(camera, foveation, spp=2)
    raw = renderer.frame(camera, foveation, spp=2)
    inside = clean.region.weight_image() >= 1
    # Seen on a screen: in linear radiance a single firefly outweighs all the rest.
    shown = srgb_from_radiance(truth)
    errors = [np.mean((srgb_from_radiance(frame.composite) - shown)[inside] ** 2) for frame in (clean, raw)]
    assert errors[0] < 0.25 * errors[1]


def test_in_a_closed_sphere_the_composite_is_one(arrays):
    scene = load_scene(small.furnace(), max_depth=40)
    frames = [render_frame(Tracer(scene), scene.camera, 16, seed) for seed in range(2)]
    views = [TrainingView(scene.camera, f.radiance, f.unfolded, f.normal) for f in frames]
    trainer = Trainer(arrays, views, TrainingSettings(iterations=150, gaussians=1000, layers=1, degree=0))
    trainer.run()
    renderer = HybridRenderer(
        scene,
        forest_from(trainer.forest(), scene.camera.fy, scene.name, scene.hash),
        Viewing(acuity_model="none"),
    )
    frame = renderer.frame(scene.camera, Foveation(Gaze(0.4, 0.6), 50, 25), spp=256)
    weight = frame.region.weight_image()
    for region in (weight >= 1, (weight > 0) & (weight < 1), weight == 0):
        assert frame.composite[region].mean() == pytest.approx(1, abs=0.02)


def test_one_point_lies_in_one_pixel_for_all(arrays, tmp_path):
    """Camera, rasterizer and transforms.json agree to 1e-3 px (Mitsuba's sensor: see the tracer's tests)."""
    scene = load_scene(small.corner())
    point = np.array([[0.2, 0.1, 1.0]])
    camera = scene.camera.resized(64, 48)
    expected, _ = camera.project(point)
    back, _ = camera_from_json(camera_to_json(camera)).project(point)
    np.testing.assert_allclose(back, expected, atol=1e-6)
    dot = Gaussians(
        torch.tensor(point.T, dtype=torch.float32),
        torch.full((3, 1), float(np.log(0.03))),
        torch.tensor([[1.0], [0], [0], [0]]),
        torch.tensor([8.0]),
        torch.full((1, 3, 1), 1.7),
    )
    from splat.raster.differentiable import parameters_from
    from splat.raster.projection import project

    splats = project(parameters_from(arrays, dot), camera, 0.1)
    np.testing.assert_allclose([splats.x[0], splats.y[0]], expected[0], atol=1e-3)
    forest = forest_from([static_layer(dot)], camera.fy, "", "")
    image = ForestRenderer(arrays, forest).render_layer(camera, 1).image()[..., 0]
    y, x = np.mgrid[0:48, 0:64] + 0.5
    centre = np.array([(image * x).sum(), (image * y).sum()]) / image.sum()
    # The cut at 1/255 is not symmetric about the centre; worst seen 0.01 px.
    np.testing.assert_allclose(centre, expected[0], atol=0.03)


def test_a_forest_of_another_scene_is_refused(renderer):
    other = load_scene(small.furnace())
    with pytest.raises(UserError, match="this forest is one of scene"):
        HybridRenderer(other, forest_of(renderer.tracer.scene))


def test_exr_layers_hold_everything(renderer, tmp_path):
    camera = renderer.tracer.scene.camera.resized(40, 30)
    gaze = Gaze(0.3, 0.7)
    frame = renderer.frame(camera, Foveation(gaze, 40, 20), spp=1)
    layers = frame_layers(renderer, camera, gaze, frame)
    write_layers(tmp_path / "f.exr", layers)
    channels = read_layers(tmp_path / "f.exr")
    assert {
        "R",
        "composite.R",
        "path-traced.G",
        "splat.B",
        "weight.V",
        "eccentricity.V",
        "level.V",
        "rate.V",
        "depth.V",
    } <= set(channels)
    np.testing.assert_array_equal(channels["composite.G"], frame.composite[..., 1])
    np.testing.assert_array_equal(channels["weight.V"], frame.region.weight_image())
    # Degrees, and nothing of them where the viewer looks.
    row, column = np.unravel_index(channels["eccentricity.V"].argmin(), (30, 40))
    assert (abs(row + 0.5 - 21), abs(column + 0.5 - 12)) <= (0.5, 0.5)
    # The back wall is 3 in front of the camera along z; the camera looks a little down and aside.
    assert 1.5 < np.median(channels["depth.V"]) < 3.2


def test_the_measures_know_what_they_measure():
    rng = small.rng()
    image = rng.uniform(0, 1, (128, 128, 3)).astype(np.float32)
    from scipy.ndimage import gaussian_filter, shift

    smooth = gaussian_filter(image, (2, 2, 0)) * 4 - 1.5
    assert psnr(smooth, smooth) > 100
    assert ssim(smooth, smooth) == pytest.approx(1)
    assert registration_px(smooth, smooth) == 0
    moved = shift(smooth, (0.3, -0.4, 0), order=3, mode="nearest").astype(np.float32)
    assert registration_px(moved, smooth) == pytest.approx(0.5, abs=0.05)
    assert psnr(smooth + 1e-3, smooth) > psnr(moved, smooth)
    assert registration_px(smooth * 0, smooth * 0) is None
