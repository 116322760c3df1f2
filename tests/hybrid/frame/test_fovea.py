"""The fovea: its modes, what each requires, and what it is made from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.eye.gaze import Gaze
from compose.fovea.band import thinned
from compose.fovea.mode import FoveaMode
from compose.fovea.region import Foveation
from compose.image.colour import srgb_from_radiance
from hybrid.frame.fovea import Fovea
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from pathtrace.trace.film import frame_positions
from pathtrace.trace.image import radiance_image
from pathtrace.trace.tracer import Tracer

SETTINGS = FrameSettings(fov_a=45, fov_b=35, acuity_model="none")


def settings_of(renderer: Renderer, mode: str, width: int, height: int, spp: int = 1) -> FrameSettings:
    return replace(SETTINGS, fovea=mode, spp=spp, camera=renderer.scene.camera.resized(width, height))


def test_raw_is_the_mean_of_the_samples(renderer):
    frame = renderer.frame(settings_of(renderer, "raw", 64, 64, spp=3), seed=5)
    assert frame.fovea.radiance is frame.fovea.samples.radiance
    assert frame.fovea.denoised is None
    assert frame.fovea.weights is None
    assert frame.underlay is None


def test_denoised_is_what_the_denoiser_makes_of_the_samples(renderer):
    frame = renderer.frame(settings_of(renderer, "denoised", 64, 64, spp=3), seed=5)
    assert frame.fovea.radiance is frame.fovea.denoised
    assert frame.fovea.weights is None
    assert frame.underlay is None
    # Neighbouring pixels differ less, and are as bright as before.
    traced, denoised = frame.fovea.samples.radiance, frame.fovea.radiance
    steps = [np.median(np.abs(np.diff(image, axis=0))) for image in (denoised, traced)]
    assert steps[0] < 0.5 * steps[1]
    assert np.median(denoised) == pytest.approx(np.median(traced), rel=0.1)


def test_a_fused_fovea_lies_between_its_parents_and_says_how(renderer):
    settings = settings_of(renderer, "fused", 65, 63, spp=4)
    frame = renderer.frame(settings, seed=1)
    fovea = frame.fovea
    np.testing.assert_allclose(fovea.weights.sum(axis=1), 1, atol=1e-5)
    underlay = renderer.splats(settings).reshape(-1, 3)[frame.region.pixels]
    parents = np.stack([fovea.samples.radiance, fovea.denoised, underlay])
    # Nothing is fitted to this forest: statistics alone, without sharpening.
    mixed = (parents * fovea.weights.T[:, :, None]).sum(axis=0)
    np.testing.assert_allclose(fovea.radiance, mixed, atol=2e-3)
    assert fovea.excluded == 0


def test_pixels_in_which_a_parent_is_left_out_are_counted(renderer):
    settings = settings_of(renderer, "fused", 48, 48)
    camera, region = settings.camera, settings.foveation.region(48, 48)
    underlay = renderer.underlay(camera, settings, region)
    broken = underlay.radiance.copy()
    broken.reshape(-1, 3)[region.pixels[:7], 0] = np.nan
    _, samples = renderer.fovea_of(settings).trace(FoveaMode.FUSED, camera, region, 1, 0, underlay)
    fovea = renderer.fovea_of(settings).image(
        FoveaMode.FUSED, region, samples, underlay=replace(underlay, radiance=broken)
    )
    assert fovea.excluded == 7
    assert np.isfinite(fovea.radiance).all()


def test_what_a_mode_requires_may_not_be_missing(renderer):
    settings = settings_of(renderer, "raw", 48, 48)
    region = settings.foveation.region(48, 48)
    samples = renderer.fovea_of(settings).disc.trace_each(
        settings.camera, region.pixels, np.ones(len(region.pixels)), 0
    )
    with pytest.raises(ValueError, match="a denoised fovea requires the radiance around the disc"):
        renderer.fovea_of(settings).image(FoveaMode.DENOISED, region, samples)
    with pytest.raises(ValueError, match="a fused fovea requires the splats under the disc"):
        renderer.fovea_of(settings).image(FoveaMode.FUSED, region, samples)


@pytest.mark.parametrize("mode", FoveaMode)
def test_a_disc_outside_the_frame_requires_no_samples(renderer, mode):
    settings = replace(settings_of(renderer, mode, 32, 32, spp=2), gaze=Gaze(5, 5), fov_a=10.0, fov_b=5.0)
    frame = renderer.frame(settings)
    np.testing.assert_array_equal(frame.composite, renderer.splats(settings))
    assert len(frame.fovea.samples.pixels) == 0
    assert renderer.paths(settings) == 0


def test_only_a_raw_fovea_without_a_history_thins_the_band(scene):
    tracer = Tracer(scene)
    region = Foveation(Gaze(), 40, 10).region(32, 32)
    for history in (False, True):
        fovea = Fovea(tracer, history=history)
        for mode in FoveaMode:
            thins = mode is FoveaMode.RAW and not history
            assert fovea.thins_band(mode) == thins
            expected = 2 * region.weights.sum() if thins else 2 * len(region.pixels)
            assert fovea.paths(mode, region, 2) == pytest.approx(float(expected))


def test_a_thinned_band_has_the_samples_and_weights_that_it_was_allotted(scene):
    camera, region = scene.camera.resized(32, 32), Foveation(Gaze(), 40, 10).region(32, 32)
    thin, samples = Fovea(Tracer(scene)).trace(FoveaMode.RAW, camera, region, 2, 7)
    expected, counts = thinned(region, 2, 7)
    np.testing.assert_array_equal(samples.pixels, expected.pixels)
    np.testing.assert_array_equal(samples.count, counts)
    np.testing.assert_array_equal(thin.weights, expected.weights)
    assert len(thin.pixels) < len(region.pixels)


def test_a_still_view_converges(scene, forest):
    camera = scene.camera.resized(48, 48)
    truth = radiance_image(Tracer(scene), camera, frame_positions(camera), 48, 2048, 99)
    renderer = Renderer(scene, forest, history=True)
    settings = settings_of(renderer, "fused", 48, 48)
    errors = []
    for seed in range(64):
        frame = renderer.frame(settings, seed)
        inside = frame.region.weight_image() >= 1
        shown = srgb_from_radiance(frame.composite) - srgb_from_radiance(truth)
        errors.append(np.mean(shown[inside] ** 2))
    assert (frame.fovea.samples.count == 64).all()
    assert errors[63] < 0.5 * errors[7] < 0.4 * errors[0]
