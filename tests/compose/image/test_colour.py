"""Luminance and sRGB, against published values."""

from __future__ import annotations

import numpy as np
import pytest

from compose.image.colour import bytes_from_radiance, luminance, srgb_from_radiance


def test_luminance_weighs_the_primaries_as_rec_709_does():
    primaries = np.eye(3, dtype=np.float32)
    np.testing.assert_allclose(luminance(primaries), [0.2126, 0.7152, 0.0722], rtol=1e-6)
    assert luminance(np.ones(3, np.float32)) == pytest.approx(1)


def test_luminance_drops_the_last_axis_and_stays_single_precision():
    found = luminance(np.full((4, 5, 3), 2, np.float32))
    assert found.shape == (4, 5)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, 2, rtol=1e-6)


@pytest.mark.parametrize(
    ("radiance", "srgb"),
    # IEC 61966-2-1: 12.92 v below 0.0031308; 18 % grey is 0.46136, half of the light 0.73536.
    [
        (0, 0),
        (0.001, 0.01292),
        (0.0031308, 0.04045),
        (0.01, 0.09985),
        (0.18, 0.46136),
        (0.5, 0.73536),
        (1, 1),
    ],
)
def test_srgb_of_known_values(radiance, srgb):
    found = srgb_from_radiance(np.full((1, 1, 3), radiance, np.float32))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, srgb, atol=2e-5)


def test_radiance_beyond_0_to_1_is_clipped():
    values = np.array([[[-1.0, 2.0, np.inf]]], dtype=np.float32)
    np.testing.assert_allclose(srgb_from_radiance(values).ravel(), [0, 1, 1], atol=1e-6)


def test_bytes_are_srgb_rounded_to_the_nearest():
    """Half of the light is 187.52 of 255; 0.0031308 is 10.3."""
    values = np.array([[[0.0, 0.5, 1.0], [-1.0, 2.0, 0.0031308]]], dtype=np.float32)
    found = bytes_from_radiance(values)
    assert found.dtype == np.uint8
    assert found.tolist() == [[[0, 188, 255], [0, 255, 10]]]
