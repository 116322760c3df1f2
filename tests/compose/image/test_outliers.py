"""Pixels that are out of all proportion."""

from __future__ import annotations

import numpy as np
import pytest

from compose.image.outliers import MOST, filled, is_plain, outliers


def image(value: float = 1.0) -> np.ndarray:
    return np.full((9, 9, 3), value, np.float32)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0, 1.01 * MOST, 3e38])
def test_one_wrong_pixel_is_found(value):
    given = image()
    given[4, 5, 1] = value
    assert not is_plain(given)
    assert np.argwhere(outliers(given)[..., 0]).tolist() == [[4, 5]]


@pytest.mark.parametrize("value", [0.0, 1e-8, 1.0, 1e6, 1e15, 1e30])
def test_what_is_bright_everywhere_is_in_proportion(value):
    assert not outliers(image(value)).any()
    assert is_plain(image(value)) == (value <= MOST)


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
