"""SSIM against its formula at a pixel, and where it is defined."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.measure.image_metrics import SSIM_MARGIN, ssim, ssim_map, valid_mean


def linear(encoded: np.ndarray) -> np.ndarray:
    """Radiance of sRGB values above 0.04."""
    return (((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)


def in_double_precision(x: np.ndarray, y: np.ndarray) -> float:
    """SSIM of two windows (11, 11), by equations 12 and 13 of Wang et al. 2004."""
    distance = np.arange(-5, 6)
    gauss = np.exp(-(distance**2) / (2 * 1.5**2))
    weight = np.outer(gauss, gauss) / np.outer(gauss, gauss).sum()
    mean_x, mean_y = (weight * x).sum(), (weight * y).sum()
    var_x, var_y = (weight * (x - mean_x) ** 2).sum(), (weight * (y - mean_y) ** 2).sum()
    both = (weight * (x - mean_x) * (y - mean_y)).sum()
    c1, c2 = 0.01**2, 0.03**2
    return float(
        (2 * mean_x * mean_y + c1) * (2 * both + c2) / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))
    )


def test_a_pixel_has_the_ssim_of_the_formula():
    rng = np.random.default_rng(1)
    first = rng.uniform(0.1, 0.9, (24, 24, 3))
    second = np.clip(first + rng.normal(0, 0.1, first.shape), 0.05, 0.95)
    found = ssim_map(linear(first), linear(second))
    for row, column in ((5, 5), (9, 14), (18, 18)):
        window = np.s_[row - 5 : row + 6, column - 5 : column + 6]
        channels = [in_double_precision(first[window][..., c], second[window][..., c]) for c in range(3)]
        assert found[row, column] == pytest.approx(np.mean(channels), abs=2e-4)


def test_flat_images_have_the_luminance_term_alone():
    """(2 ab + C1) / (a^2 + b^2 + C1) of 0.4 and 0.7 is 0.5601 / 0.6501."""
    flat = [linear(np.full((32, 32, 3), value)) for value in (0.4, 0.7)]
    assert ssim(*flat) == pytest.approx(0.5601 / 0.6501, abs=1e-5)
    assert ssim(flat[0], flat[0]) == pytest.approx(1)


def test_only_pixels_whose_window_lies_in_the_image_count():
    ring = np.ones((20, 30), dtype=np.float32)
    ring[SSIM_MARGIN:-SSIM_MARGIN, SSIM_MARGIN:-SSIM_MARGIN] = 0.25
    assert SSIM_MARGIN == 5
    assert valid_mean(ring) == 0.25


def test_weights_choose_pixels():
    values = np.zeros((20, 30), dtype=np.float32)
    values[8, 9], values[10, 20] = 0.5, 1.0
    weight = np.zeros_like(values)
    weight[8, 9], weight[10, 20] = 3, 1
    assert valid_mean(values, weight) == pytest.approx((3 * 0.5 + 1.0) / 4)
    # Outside the valid pixels weights have no influence.
    weight[0] = 100
    assert valid_mean(values, weight) == pytest.approx((3 * 0.5 + 1.0) / 4)


def test_ssim_with_a_weight_is_the_weighted_mean_of_the_map():
    rng = np.random.default_rng(2)
    image, reference, weight = (rng.uniform(0, 1, (24, 24, 3)).astype(np.float32) for _ in range(3))
    weighted = ssim(image, reference, weight[..., 0])
    assert weighted == valid_mean(ssim_map(image, reference), weight[..., 0]) != ssim(image, reference)
