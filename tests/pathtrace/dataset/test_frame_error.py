"""The error that a frame states of itself, against its distance from the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pathtrace.dataset.frame_error as module
from compose.image.colour import srgb_from_radiance, srgb_slope
from pathtrace.dataset.frame_error import (
    FrameError,
    frame_error,
    mean_frame_error,
)
from pathtrace.trace.traced_images import TracedImage
from tests.extremes import extreme

pytestmark = pytest.mark.usefixtures("backend")
SIZE = 96


@pytest.fixture(scope="module")
def wall() -> TracedImage:
    """A tiled wall under uneven light, without noise."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    tile = (np.floor(x * 8) + np.floor(y * 8))[..., None] % 2
    albedo = np.where(tile, [0.9, 0.6, 0.3], [0.2, 0.3, 0.4]).astype(np.float32)
    light = 0.4 + 0.5 * x + 0.2 * np.sin(17 * y * (1 + x)) + 0.2 * (np.hypot(x - 0.5, y - 0.4) < 0.2)
    normal = np.broadcast_to(np.float32([0, 0, 1]), albedo.shape)
    return TracedImage((albedo * light[..., None]).astype(np.float32), albedo, normal)


def noisy(image: TracedImage, spread: float, seed: int) -> TracedImage:
    """The image with gamma noise of a relative standard deviation, one factor for all channels of a pixel."""
    shape = 1 / spread**2
    noise = np.random.default_rng(seed).gamma(shape, 1 / shape, image.radiance.shape[:2])
    return replace(image, radiance=(image.radiance * noise[..., None]).astype(np.float32))


def psnr_db(image: np.ndarray, truth: np.ndarray) -> float:
    squares = (srgb_from_radiance(image).astype(float) - srgb_from_radiance(truth)) ** 2
    return float(-10 * np.log10(squares.mean()))


@pytest.mark.parametrize("spread", [0.2, 0.6, 1.5])
def test_the_error_stated_is_the_error_made(wall, spread):
    """Without having seen the truth, to 1.5 dB."""
    errors, truths = [], []
    for seed in range(3):
        halves = noisy(wall, spread, 2 * seed), noisy(wall, spread, 2 * seed + 1)
        denoised = halves[0].mixed(halves[1], 0.5).denoised()
        errors.append(frame_error(*halves, denoised))
        truths.append(10 ** (-psnr_db(denoised, wall.radiance) / 10))
    assert mean_frame_error(errors).psnr_db == pytest.approx(-10 * np.log10(np.mean(truths)), abs=1.5)


def denoised_to(monkeypatch, images: list[np.ndarray]) -> None:
    """Lets denoising give images, one after the other."""
    left = iter(images)
    monkeypatch.setattr(TracedImage, "denoised", lambda self, quick=False: next(left))


def test_its_parts_are_those_of_a_float64_twin(wall, monkeypatch):
    halves = noisy(wall, 0.5, 1), noisy(wall, 0.5, 2)
    clean = [np.float32(factor) * wall.radiance for factor in (0.9, 1.05, 0.97)]
    denoised_to(monkeypatch, clean)
    found = frame_error(*halves)
    one, other, both = (image.astype(float) for image in clean)
    mean = (one + other) / 2
    encoded = [srgb_from_radiance(image).astype(float) for image in (one, other, both, mean)]
    # Below 1 and above the curve's straight part, as all of the wall is.
    slope = 1.055 / 2.4 * mean ** (1 / 2.4 - 1)
    product = slope**2 * (one - halves[0].radiance) * (other - halves[1].radiance)
    assert 0.0031308 < mean.min() < mean.max() < 1
    assert found.variance == pytest.approx(((encoded[0] - encoded[1]) ** 2).mean() / 2, rel=1e-4)
    assert found.change == pytest.approx(((encoded[2] - encoded[3]) ** 2).mean(), rel=1e-4)
    assert found.product == pytest.approx(product.mean(), rel=1e-4)
    blocks = product.reshape(6, 16, 6, 16, 3).mean((1, 3, 4))
    assert found.deviation == pytest.approx(blocks.std(ddof=1) / 6, rel=1e-4)


def test_the_product_is_the_squared_bias_without_bias(wall, monkeypatch):
    """Of many frames whose denoiser makes everything 10 % too bright, however noisy these are."""
    bright = np.float32(1.1) * wall.radiance
    denoised_to(monkeypatch, [bright] * 90)
    found = mean_frame_error(
        [frame_error(noisy(wall, 0.6, 2 * seed), noisy(wall, 0.6, 2 * seed + 1)) for seed in range(30)]
    )
    slope = srgb_slope(bright).astype(float)
    bias = np.mean((slope * (bright - wall.radiance)) ** 2)
    assert found.deviation < 0.2 * bias
    assert abs(found.product - bias) < 4 * found.deviation


def test_slope_is_the_derivative_of_the_curve():
    radiance = np.float32([1e-4, 0.002, 0.01, 0.2, 0.9])
    step = np.float32(1e-3) * radiance
    difference = srgb_from_radiance(radiance + step) - srgb_from_radiance(radiance - step)
    np.testing.assert_allclose(srgb_slope(radiance), difference / (2 * step), rtol=0.02)
    np.testing.assert_array_equal(srgb_slope(np.float32([1, 7])), 0)


def test_what_is_unsure_counts_less():
    """A product known exactly is believed; one that is not known leaves what the change tells."""
    sure = FrameError(variance=2e-4, change=1e-4, product=4e-4, deviation=0)
    unsure = replace(sure, deviation=np.inf)
    assert sure.mse == pytest.approx(module._JOINT_SHARE * 5e-4)
    assert unsure.mse == pytest.approx(module._JOINT_SHARE * (1e-4 + module._BIAS_PER_CHANGE * 1e-4))
    assert sure.psnr_db == pytest.approx(-10 * np.log10(sure.mse))


def test_many_frames_are_surer_than_one():
    one = FrameError(variance=2e-4, change=1e-4, product=4e-4, deviation=2e-4)
    four = mean_frame_error([one] * 4)
    assert four == FrameError(one.variance, one.change, one.product, pytest.approx(1e-4))
    with pytest.raises(ValueError, match="no frames"):
        mean_frame_error([])


def test_halves_must_be_of_one_size(wall):
    cut = TracedImage(*(image[:-1] for image in (wall.radiance, wall.albedo, wall.normal)))
    with pytest.raises(ValueError, match="one size"):
        frame_error(wall, cut)


@extreme("error of a frame with one firefly", given="a sample of 1e6", expected="the true one, to 2.5 dB")
def test_a_firefly_does_not_spoil_the_statement(wall, got):
    """Without a bound on residuals, it would alone: it is a million times as bright as the wall."""
    halves = [noisy(wall, 0.5, seed) for seed in (1, 2)]
    radiance = halves[0].radiance.copy()
    radiance[40, 40] = 1e6
    halves[0] = replace(halves[0], radiance=radiance)
    denoised = halves[0].mixed(halves[1], 0.5).denoised()
    stated, true = frame_error(*halves, denoised).psnr_db, psnr_db(denoised, wall.radiance)
    assert got(stated - true, ".2f") == pytest.approx(0, abs=2.5)


@extreme("error of a frame without light", given="black halves", expected="120 dB")
def test_black_frames_have_no_error(wall, got):
    black = replace(wall, radiance=np.zeros_like(wall.radiance))
    found = frame_error(black, black)
    assert got(found.psnr_db, ".0f") == 120


@extreme("error of the smallest frame", given="1 x 1 pixels", expected="finite, the product not believed")
def test_a_single_pixel_has_an_error(wall, got):
    halves = [
        TracedImage(*(image[:1, :1] for image in (half.radiance, half.albedo, half.normal)))
        for half in (noisy(wall, 0.5, 1), noisy(wall, 0.5, 2))
    ]
    found = frame_error(*halves)
    assert found.deviation == np.inf
    assert np.isfinite(got(found.psnr_db, ".1f"))


def test_the_halves_are_joined_by_their_means(wall):
    halves = noisy(wall, 0.5, 1), noisy(wall, 0.5, 2)
    both = halves[0].mixed(halves[1], 0.5)
    np.testing.assert_allclose(both.radiance, (halves[0].radiance + halves[1].radiance) / 2, rtol=1e-6)
    np.testing.assert_allclose(both.albedo, wall.albedo, rtol=1e-6)
    np.testing.assert_allclose(both.normal, wall.normal, rtol=1e-6)
