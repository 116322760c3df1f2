"""The hybrid frame: exact at both ends, right in between, and correct in a closed sphere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.camera.coordinate_systems import camera_from_json, camera_to_json
from compose.fovea.foveation import FoveaMode
from compose.image.colour import srgb_from_radiance
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.dataset.captured_frames import render_frame
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.traced_images import radiance_image
from pathtrace.trace.tracer import Tracer
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import forest_of
from splat.raster.projection import camera_numbers, project
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.training_view import TrainingView
from tests import small
from tests.compose.arrays_of import host, numbers
from tests.hybrid.forests import white_dot
from tests.hybrid.render.passes import waits
from tests.splat.raster.splats import parameters_from

pytestmark = pytest.mark.usefixtures("backend")
RAW = FrameSettings(fov_a=40, fov_b=20, spp=1, fovea="raw", acuity_model="none")
BAND = replace(RAW, fov_a=45, fov_b=20, spp=3)


def sized(settings: FrameSettings, renderer: Renderer, width: int, height: int) -> FrameSettings:
    return replace(settings, camera=renderer.scene.camera.resized(width, height))


def path_traced(renderer: Renderer, camera: Camera, spp: int, seed: int):
    """(H, W, 3) the whole frame, path-traced."""
    return radiance_image(renderer.tracer, camera, frame_positions(camera), camera.width, spp, seed)


def test_a_covering_disc_is_the_path_traced_frame_exactly(renderer):
    frame = renderer.frame(replace(RAW, fov_a=500, fov_b=10, spp=2), seed=4)
    assert np.array_equal(frame.composite, path_traced(renderer, renderer.scene.camera, 2, 4))


@pytest.mark.parametrize("mode", FoveaMode)
def test_no_disc_is_the_splat_frame_exactly(renderer, mode):
    settings = replace(RAW, fov_a=0, fov_b=0, fovea=mode)
    frame = renderer.frame(settings)
    assert np.array_equal(frame.composite, renderer.splats(settings))
    assert frame.composite.max() > 0.1
    assert len(frame.region.pixels) == 0


@pytest.mark.parametrize("gaze", [(0.5, 0.5), (0, 0), (1, 1), (-0.2, 0.4), (3, 3)])
def test_each_pixel_is_the_weighted_mean_of_both(renderer, gaze):
    settings = sized(replace(RAW, gaze=gaze), renderer, 70, 50)
    frame = renderer.frame(settings)
    weight = frame.weight_image()[..., None]
    whole = renderer.splats(settings)
    expected = weight * frame.of_disc(frame.fovea.radiance) + (1 - weight) * whole
    np.testing.assert_allclose(frame.composite, expected, atol=1e-5)
    assert np.isfinite(frame.composite).all()


def test_only_the_disc_is_traced_and_hidden_tiles_are_not_rasterized(renderer):
    settings = sized(replace(RAW, fov_a=45, fov_b=40), renderer, 160, 160)
    frame = renderer.frame(settings)
    assert frame.fovea.samples.size == frame.weight_image().astype(bool).sum()
    assert np.isin(numbers(frame.fovea.samples, "pixels"), frame.region.pixels).all()
    assert (frame.periphery[72:88, 72:88] == 0).all()
    assert (renderer.splats(settings)[72:88, 72:88] > 0).any()


def test_the_same_seed_gives_the_same_frame_and_another_one_another(renderer):
    first, again, other = (renderer.frame(RAW, seed).composite for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert np.array_equal(renderer.frame(RAW).composite, renderer.frame(RAW, seed=0).composite)


def test_splats_are_rendered_under_the_disc_only_if_they_are_fused_with_it(renderer):
    settings = sized(RAW, renderer, 64, 64)
    region = settings.foveation.region(64, 64)
    for mode in FoveaMode:
        underlay = renderer.underlay(settings.camera, replace(settings, fovea=mode), region)
        assert (underlay is not None) == (mode is FoveaMode.FUSED)


def test_the_frame_says_how_it_was_made(renderer):
    camera = renderer.scene.camera.resized(64, 48)
    frame = renderer.frame(replace(RAW, camera=camera, scale=0.5, spp=2))
    assert frame.camera == camera.resized(32, 24)
    assert frame.settings.camera == frame.camera
    assert (frame.settings.scale, frame.settings.spp) == (1, 2)
    assert frame.settings.display.width == 960
    assert frame.composite.shape == frame.periphery.shape == (24, 32, 3)
    assert (frame.region.width, frame.region.height) == (32, 24)


def test_without_a_camera_the_scenes_own_view_is_rendered(renderer):
    frame = renderer.frame(RAW)
    assert frame.camera == renderer.scene.camera
    assert np.array_equal(
        frame.composite, renderer.frame(replace(RAW, camera=renderer.scene.camera)).composite
    )


def test_times_are_those_of_the_passes_in_their_order(renderer):
    milliseconds = renderer.frame(replace(RAW, fovea="fused")).milliseconds
    passes = ["region", "detail", "splat", "fill", "trace", "fovea", "blend"]
    passes += waits()
    assert list(milliseconds) == [*passes, "total"]
    assert sum(milliseconds[name] for name in passes) == pytest.approx(milliseconds["total"])


def test_in_the_band_a_raw_disc_has_as_many_samples_as_it_shows(renderer):
    settings = sized(BAND, renderer, 160, 160)
    whole = settings.foveation.region(160, 160)
    frame = renderer.frame(settings)
    count = frame.of_disc([frame.fovea.samples.count])[..., 0]
    assert (count[whole.weight_image() == 1] == 3).all()
    assert np.abs(count - 3 * whole.weight_image()).max() < 1
    assert count.sum() == pytest.approx(renderer.paths(settings), rel=0.01)
    # Of the band, whose weights fall linearly to 0 from 20 % to 45 % of the height, a half-cone is traced.
    cone = np.pi * (45**2 + 45 * 20 + 20**2) / 3 / 100**2
    assert renderer.paths(settings) == pytest.approx(3 * cone * 160**2, rel=0.01)


def test_samples_that_are_reused_or_denoised_are_taken_everywhere(scene, forest, renderer):
    settings = sized(replace(BAND, spp=1), renderer, 48, 48)
    whole = settings.foveation.region(48, 48)
    reusing = Renderer(scene, forest, history=True)
    for other, mode in ((reusing, "raw"), (renderer, "denoised"), (renderer, "fused")):
        chosen = replace(settings, fovea=mode)
        frame = other.frame(chosen)
        np.testing.assert_allclose(frame.weight_image(), whole.weight_image(), atol=1e-5)
        assert (numbers(frame.fovea.samples, "count") == 1).all()
        assert other.paths(chosen) == len(whole.pixels)


@pytest.mark.parametrize("mode", FoveaMode)
def test_the_disc_alone_is_the_disc_of_the_frame(renderer, mode):
    settings = sized(replace(BAND, fovea=mode), renderer, 64, 64)
    frame, alone = renderer.frame(settings, seed=2), renderer.disc_alone(settings, seed=2)
    for name in ("pixels", "weights"):
        own, other = (np.asarray(getattr(fovea.disc, name)) for fovea in (alone, frame.fovea))
        np.testing.assert_array_equal(own, other)
    found, expected = host(alone.radiance), host(frame.fovea.radiance)
    assert found.shape == expected.shape
    if mode is FoveaMode.DENOISED:
        # The denoiser sees the splats around the disc, which are not rendered for the disc alone.
        inside = np.asarray(frame.fovea.disc.weights) == 1
        differs = np.abs(found - expected)[inside].mean()
        assert 0 < differs < 0.05 * expected[inside].mean()
    else:
        np.testing.assert_allclose(found, expected, rtol=small.denoising_error(), atol=1e-6)


def test_a_denoised_disc_is_closer_to_the_truth(renderer):
    settings = sized(replace(RAW, fov_a=60, fov_b=55, spp=2), renderer, 96, 96)
    truth = path_traced(renderer, settings.camera, 1024, 1)
    clean, raw = (renderer.frame(replace(settings, fovea=mode)) for mode in ("denoised", "raw"))
    inside = clean.region.weight_image() >= 1
    # Seen on a screen: in linear radiance a single firefly outweighs all the rest.
    shown = srgb_from_radiance(truth)
    errors = [np.mean((srgb_from_radiance(frame.composite) - shown)[inside] ** 2) for frame in (clean, raw)]
    assert errors[0] < 0.25 * errors[1]


def test_in_a_closed_sphere_the_composite_is_one(arrays):
    scene = load_scene(small.furnace(), max_depth=40)
    frames = [render_frame(Tracer(scene), scene.camera, 16, seed) for seed in range(2)]
    views = [TrainingView(scene.camera, f.radiance, f.unfolded, f.normal) for f in frames]
    trainer = Trainer(arrays, views, TrainingSettings(iterations=60, gaussians=500, layers=1, degree=0))
    trainer.run()
    forest = forest_of(trainer.forest(), scene.camera.fy, scene.name, scene.hash)
    settings = replace(RAW, gaze=(0.4, 0.6), fov_a=50, fov_b=25, spp=256)
    frame = Renderer(scene, forest).frame(settings)
    weight = frame.region.weight_image()
    for region in (weight >= 1, (weight > 0) & (weight < 1), weight == 0):
        assert frame.composite[region].mean() == pytest.approx(1, abs=0.02)


def test_one_point_lies_in_one_pixel_for_all(arrays, scene):
    """Camera, rasterizer and transforms.json agree to 1e-3 px (Mitsuba's sensor: see the tracer's tests)."""
    point = np.array([[0.2, 0.1, 1.0]])
    camera = scene.camera.resized(64, 48)
    expected, _ = camera.project(point)
    back, _ = camera_from_json(camera_to_json(camera)).project(point)
    np.testing.assert_allclose(back, expected, atol=1e-6)
    forest = white_dot((0.2, 0.1, 1.0), camera.fy)
    splats = project(parameters_from(arrays, forest.finest), camera_numbers(arrays, camera), 0.1)
    np.testing.assert_allclose([splats.x[0], splats.y[0]], expected[0], atol=1e-3)
    image = ForestRenderer(arrays, forest).render_layer(camera, 1).numpy()[..., 0]
    y, x = np.mgrid[0:48, 0:64] + 0.5
    centre = np.array([(image * x).sum(), (image * y).sum()]) / image.sum()
    # The cut at 1/255 is not symmetric about the centre; worst seen 0.01 px.
    np.testing.assert_allclose(centre, expected[0], atol=0.03)


def test_a_forest_of_another_scene_is_refused(forest):
    other = load_scene(small.furnace())
    with pytest.raises(UserError, match="this forest belongs to scene"):
        Renderer(other, forest)


def test_layers_that_the_forest_does_not_have_are_refused(renderer):
    for layers in ((1, 4), (0, 2), (3, 2)):
        with pytest.raises(UserError, match=f"layers {layers[0]} {layers[1]}: this forest has layers 1 to 3"):
            renderer.frame(replace(RAW, layers=layers))


def test_depth_is_that_along_the_view_axis(renderer):
    camera = renderer.scene.camera.resized(40, 30)
    depth = renderer.depth(camera)
    assert depth.shape == (30, 40)
    # All is seen in front of the wall at z = 2 or on it, and the wall fills most of the frame.
    points = (
        camera.position
        + camera.rays(camera.pixel_centres())
        * (depth.ravel() / (camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]))[:, None]
    )
    assert points[:, 2].max() == pytest.approx(2, abs=1e-3)
    assert np.median(points[:, 2]) == pytest.approx(2, abs=1e-3)
