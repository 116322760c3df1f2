"""The fovea: its modes, what each requires, and what it is made from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.eye.gaze import Gaze
from compose.fovea.disc import thinned
from compose.fovea.foveation import FoveaMode, Foveation
from compose.image.colour import srgb_from_radiance
from hybrid.render.forest_attachments import attach_errors
from hybrid.render.fovea import Fovea
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from pathtrace.trace.film import frame_positions
from pathtrace.trace.traced_images import radiance_image
from pathtrace.trace.tracer import Tracer
from tests.compose.arrays_of import host, image_on, numbers

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
    traced, denoised = numbers(frame.fovea.samples, "radiance"), host(frame.fovea.radiance)
    steps = [np.median(np.abs(np.diff(image, axis=0))) for image in (denoised, traced)]
    assert steps[0] < 0.5 * steps[1]
    assert np.median(denoised) == pytest.approx(np.median(traced), rel=0.1)


def test_a_fused_fovea_is_made_of_its_parents_and_says_how(renderer):
    settings = settings_of(renderer, "fused", 65, 63, spp=4)
    frame = renderer.frame(settings, seed=1)
    fovea, weights = frame.fovea, host(frame.fovea.weights)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    underlay = renderer.splats(settings).reshape(-1, 3)[frame.region.pixels]
    # The splats are relit and sharpened.
    traced, denoised, relit, splat = weights.T[:, :, None]
    others = traced * numbers(fovea.samples, "radiance") + denoised * host(fovea.denoised)
    shown = (relit + splat)[:, 0] * underlay.min(axis=1) > 0.002
    changed = ((host(fovea.radiance) - others) / np.maximum((relit + splat) * underlay, 1e-9))[shown]
    assert shown.mean() > 0.2
    assert np.abs(np.log(np.median(changed))) < 0.2
    assert (changed > 0).all()
    assert fovea.excluded == 0


@pytest.mark.parametrize(("spp", "error", "denoises"), [(1, 1e-4, False), (2, 1e-4, True), (1, 1e-3, True)])
def test_single_samples_are_denoised_where_the_splats_are_poor(scene, forest, spp, error, denoises):
    expecting = attach_errors(forest, torch.full((forest.counts[0],), error))
    renderer = Renderer(scene, expecting)
    fovea = renderer.frame(settings_of(renderer, "fused", 48, 48, spp), seed=1).fovea
    assert (fovea.denoised is not None) == denoises
    assert (host(fovea.weights)[:, 1].max() > 0) == denoises


def test_pixels_in_which_a_parent_is_left_out_are_counted(renderer, arrays):
    settings = settings_of(renderer, "fused", 48, 48)
    camera, region = settings.camera, settings.foveation.region(48, 48)
    disc, underlay = region.disc(arrays), renderer.underlay(camera, settings, region)
    image = np.array(underlay.radiance.numpy())
    image.reshape(-1, 3)[region.pixels[:7], 0] = np.nan
    broken = replace(underlay, radiance=image_on(arrays, image))
    maker = renderer.fovea_of(settings)
    _, samples = maker.trace(FoveaMode.FUSED, camera, disc, 1, 0, underlay)
    fovea = maker.image(FoveaMode.FUSED, disc, samples, underlay=broken)
    assert fovea.excluded == 7
    assert np.isfinite(host(fovea.radiance)).all()


def test_what_a_mode_requires_may_not_be_missing(renderer, arrays):
    settings = settings_of(renderer, "raw", 48, 48)
    disc = settings.foveation.region(48, 48).disc(arrays)
    samples = renderer.fovea_of(settings).disc.trace_each(settings.camera, disc.pixels, 1, 0)
    with pytest.raises(ValueError, match="a denoised fovea requires the radiance around the disc"):
        renderer.fovea_of(settings).image(FoveaMode.DENOISED, disc, samples)
    with pytest.raises(ValueError, match="a fused fovea requires the splats under the disc"):
        renderer.fovea_of(settings).image(FoveaMode.FUSED, disc, samples)


@pytest.mark.parametrize("mode", FoveaMode)
def test_a_disc_outside_the_frame_requires_no_samples(renderer, mode):
    settings = replace(settings_of(renderer, mode, 32, 32, spp=2), gaze=Gaze(5, 5), fov_a=10.0, fov_b=5.0)
    frame = renderer.frame(settings)
    np.testing.assert_array_equal(frame.composite, renderer.splats(settings))
    assert frame.fovea.samples.size == 0
    assert renderer.paths(settings) == 0


def test_only_a_raw_fovea_without_a_history_thins_the_band(scene, arrays):
    tracer = Tracer(scene)
    region = Foveation(Gaze(), 40, 10).region(32, 32)
    disc = region.disc(arrays)
    for history in (False, True):
        fovea = Fovea(tracer, history=history)
        for mode in FoveaMode:
            thins = mode is FoveaMode.RAW and not history
            assert fovea.thins_band(mode) == thins
            expected = 2 * region.weight_image().sum() if thins else 2 * region.count
            assert fovea.paths(mode, disc, 2) == pytest.approx(float(expected))


def test_a_thinned_band_has_the_samples_and_weights_that_it_was_allotted(scene, arrays):
    camera, disc = scene.camera.resized(32, 32), Foveation(Gaze(), 40, 10).region(32, 32).disc(arrays)
    thin, samples = Fovea(Tracer(scene)).trace(FoveaMode.RAW, camera, disc, 2, 7)
    expected, counts = thinned(disc, 2, 7)
    np.testing.assert_array_equal(numbers(samples, "pixels"), np.asarray(expected.pixels))
    np.testing.assert_array_equal(numbers(samples, "count"), np.asarray(counts.each))
    np.testing.assert_array_equal(np.asarray(thin.weights), np.asarray(expected.weights))
    assert thin.count < disc.count


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
    assert (numbers(frame.fovea.samples, "count") == 64).all()
    assert errors[63] < 0.5 * errors[7] < 0.4 * errors[0]
