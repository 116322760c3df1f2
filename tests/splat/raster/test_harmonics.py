"""Spherical harmonics equal their definition; the sRGB curve has its published values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import factorial, lpmv

from splat.raster.projection import perceptual_radiance, radiance_from_perceptual


def basis(arrays, directions: np.ndarray) -> np.ndarray:
    """(16, N) values of each harmonic, read off by coefficients of 1."""
    Float = arrays.plain.Float
    axes = [Float(axis.astype(np.float32)) for axis in directions]
    rows = []
    for k in range(16):
        sh = [[Float(float(j == k))] * 3 for j in range(16)]
        rows.append(perceptual_radiance(sh, axes)[1].numpy() - 0.5)
    return np.array(rows)


def directions(n: int) -> np.ndarray:
    vectors = np.random.default_rng(0).normal(size=(3, n))
    return vectors / np.linalg.norm(vectors, axis=0)


def test_harmonics_are_made_of_legendre_functions(arrays):
    """Real harmonics for m from -l to l; SciPy's functions include the Condon-Shortley phase."""
    d = directions(50)
    azimuth = np.arctan2(d[1], d[0])
    expected = []
    for degree in range(4):
        for m in range(-degree, degree + 1):
            k = abs(m)
            norm = (2 * degree + 1) / (4 * np.pi) * factorial(degree - k) / factorial(degree + k)
            wave = np.sin(k * azimuth) if m < 0 else np.cos(k * azimuth)
            expected.append(np.sqrt(norm * (1 if m == 0 else 2)) * lpmv(k, degree, d[2]) * wave)
    np.testing.assert_allclose(basis(arrays, d), expected, atol=2e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_channels_do_not_mix(arrays, degree):
    Float = arrays.plain.Float
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=((degree + 1) ** 2, 3)).astype(np.float32)
    d = directions(20)
    found = perceptual_radiance(
        [[Float(value) for value in row] for row in coefficients], [Float(a.astype(np.float32)) for a in d]
    )
    values = basis(arrays, d)[: len(coefficients)]
    for channel in range(3):
        expected = 0.5 + coefficients[:, channel] @ values
        np.testing.assert_allclose(found[channel].numpy() + np.zeros(20), expected, atol=1e-5)


def test_the_curve_has_its_published_values(arrays):
    """IEC 61966-2-1: 0.5 is 0.2140 linear, 0.04045 is 0.0031308; above 1 the power continues."""
    perceptual = arrays.plain.Float([-0.2, 0.0, 0.02, 0.04045, 0.5, 1.0, 5.0])
    expected = [0, 0, 0.02 / 12.92, 0.0031308, 0.214041, 1, (5.055 / 1.055) ** 2.4]
    np.testing.assert_allclose(radiance_from_perceptual(perceptual).numpy(), expected, rtol=1e-5)
