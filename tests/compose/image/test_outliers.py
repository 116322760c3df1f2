"""Pixels that are out of all proportion."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.image.outliers import MOST, all_plain, filled, outliers
from tests.compose.arrays_of import channels, floats


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
