"""Luminance and sRGB, against published values; pixels that are out of all proportion."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.image.colour import (
    MOST,
    bytes_from_radiance,
    filled,
    luminance,
    outliers,
    srgb_from_radiance,
)
from compose.image.device_image import all_plain
from tests.compose.arrays_of import channels, floats


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


def image(value: float = 1.0) -> np.ndarray:
    return np.full((9, 9, 3), value, np.float32)


def is_plain(arrays: Arrays, given: np.ndarray) -> bool:
    """Whether all of an image (..., 3) is, in one array and in three."""
    one, three = all_plain([floats(arrays, given.ravel())]), all_plain(channels(arrays, given.reshape(-1, 3)))
    assert one == three
    return one


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0, 1.01 * MOST, 3e38])
def test_one_wrong_pixel_is_found(arrays, value):
    given = image()
    given[4, 5, 1] = value
    assert not is_plain(arrays, given)
    assert np.argwhere(outliers(given)[..., 0]).tolist() == [[4, 5]]


@pytest.mark.parametrize("value", [0.0, 1e-8, 1.0, 1e6, 1e15, 1e30])
def test_what_is_bright_everywhere_is_in_proportion(arrays, value):
    assert not outliers(image(value)).any()
    assert is_plain(arrays, image(value)) == (value <= MOST)


@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize("size", [1, 7, 1000])
@pytest.mark.parametrize(
    ("value", "plain"),
    [
        (np.nan, False),
        (np.inf, False),
        (-np.inf, False),
        (-1.2e-38, False),
        (-1e-30, False),
        (np.nextafter(np.float32(MOST), np.float32(np.inf)), False),
        (MOST, True),
        (0.0, True),
        (-0.0, True),
        (1e-45, True),
    ],
)
def test_one_number_decides_whether_all_are_plain(arrays, channel, size, value, plain):
    """Wherever it stands, the last place included. Kernels take what is denormal for 0."""
    for place in {0, size // 2, size - 1}:
        given = np.ones((size, 3), np.float32)
        given[place, channel] = value
        assert is_plain(arrays, given) == plain


def test_many_bright_numbers_are_plain(arrays):
    """Their sum is beyond float32's precision, and beyond MOST."""
    assert is_plain(arrays, np.full((10_000, 3), MOST, np.float32))


def test_a_bright_pixel_needs_one_that_vouches_for_it():
    """A neighbour, or another image there; of itself it may be 2^24 times as bright as 1."""
    given, other = image(), image()
    given[0, 0] = 2 * MOST
    other[0, 1] = 2
    assert outliers(given)[0, 0]
    assert not outliers(given, other).any()
    other[0, 1], given[1, 1] = 1, 3
    assert not outliers(given, other).any()
    assert outliers(given, other, beside=False)[0, 0]
    given[0, 0], given[1, 1] = MOST, 0
    assert not outliers(given).any()


def test_wrong_pixels_are_filled_from_those_around_them():
    """The corner has three neighbours, one of which is wrong: of 2 and 4 the mean is 3."""
    given = image(0)
    given[0, 1], given[1, 0] = 2, 4
    given[0, 0] = given[1, 1] = np.nan
    wrong = outliers(given)
    result = filled(given, wrong)
    np.testing.assert_allclose(result[0, 0], 3)
    np.testing.assert_array_equal(result[~wrong[..., 0]], given[~wrong[..., 0]])
    assert (filled(image(np.nan), outliers(image(np.nan))) == 0).all()
