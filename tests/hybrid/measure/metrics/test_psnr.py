"""PSNR against values computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.measure.image_metrics import psnr, psnr_of_error


def flat(value: float, shape: tuple[int, ...] = (6, 4, 3)) -> np.ndarray:
    return np.full(shape, value, dtype=np.float32)


def test_dark_radiance_is_compared_on_the_linear_part_of_srgb():
    """0.001 and 0.003 are 0.01292 and 0.03876 in sRGB: -20 log10 of the difference is 31.75 dB."""
    assert psnr(flat(0.001), flat(0.003)) == pytest.approx(31.7542, abs=1e-3)


def test_white_against_black_is_0_db_and_values_above_1_count_as_1():
    assert psnr(flat(1.0), flat(0.0)) == pytest.approx(0, abs=1e-5)
    assert psnr(flat(7.0), flat(-2.0)) == pytest.approx(0, abs=1e-5)
    assert psnr(flat(1.5), flat(3.0)) == 120


def test_a_half_of_the_pixels_has_half_of_the_error():
    image, reference = flat(0.001), flat(0.001)
    image[:3] = 0.003
    wrong = np.zeros((6, 4), dtype=bool)
    wrong[:3] = True
    assert psnr(image, reference) == pytest.approx(31.7542 + 3.0103, abs=1e-3)
    assert psnr(image, reference, wrong) == pytest.approx(31.7542, abs=1e-3)
    assert psnr(image, reference, ~wrong) == 120


def test_one_channel_of_three_has_a_third_of_the_error():
    image = flat(0.001)
    image[..., 1] = 0.003
    assert psnr(image, flat(0.001)) == pytest.approx(31.7542 + 4.7712, abs=1e-3)


def test_lists_of_pixels_are_compared_like_images():
    rng = np.random.default_rng(0)
    image, reference = (rng.uniform(0, 1, (6, 4, 3)).astype(np.float32) for _ in range(2))
    assert psnr(image.reshape(-1, 3), reference.reshape(-1, 3)) == psnr(image, reference)


def test_noise_of_a_known_size_gives_its_psnr():
    """PSNR of noise of deviation s in sRGB is -20 log10 s: 33.98 dB for 0.02."""
    encoded = 0.5 + np.random.default_rng(0).normal(0, 0.02, (128, 128, 3))
    linear = (((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)
    middle = flat(((0.5 + 0.055) / 1.055) ** 2.4, (128, 128, 3))
    assert psnr(linear, middle) == pytest.approx(33.979, abs=0.1)


def test_errors_are_decibels_below_1_and_vanishing_ones_have_120():
    assert psnr_of_error(0.01) == pytest.approx(20)
    assert psnr_of_error(1.0) == 0
    assert psnr_of_error(0.0) == psnr_of_error(1e-15) == 120
