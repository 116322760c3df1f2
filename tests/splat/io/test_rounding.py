"""Sizes, opacities and colours come back within their stated bounds, and rounding twice changes nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit

from splat.io import compact as rounding
from splat.model.gaussians import SH_DC
from tests.extremes import extreme

_FLOAT32 = float(np.finfo(np.float32).max)
ENCODINGS: dict[str, tuple[Callable, Callable]] = {
    "log scales": (rounding.codes_of_log_scales, rounding.log_scales_of_codes),
    "opacities": (rounding.codes_of_opacities, rounding.logits_of_codes),
    "constants": (rounding.codes_of_constants, rounding.constants_of_codes),
    "harmonics": (rounding.codes_of_harmonics, rounding.harmonics_of_codes),
}
floats = st.floats(width=32, allow_nan=False, allow_infinity=False)


def _stored(name: str, values: np.ndarray) -> np.ndarray:
    """Values after a file: rounded, then float32."""
    encode, decode = ENCODINGS[name]
    return decode(encode(np.asarray(values, np.float64))).astype(np.float32)


def _within(found: np.ndarray, exact: np.ndarray, step: float) -> bool:
    """Whether values are right to half a step, or larger ones to that share."""
    # To first order; a logarithm's half step is a little more, and float32 rounds.
    return bool((np.abs(found - exact) <= 1.01 * step / 2 * np.maximum(np.abs(exact), 1) + 1e-6).all())


def test_sizes_are_right_to_a_64th_of_a_logarithm():
    exact = np.linspace(-120, 120, 9973)
    assert np.abs(_stored("log scales", exact) - exact).max() <= 1 / 64 + 1e-5


def test_opacities_are_right_to_1_in_512():
    exact = np.r_[np.linspace(-9, 9, 9973), -1e30, 1e30]
    found = expit(_stored("opacities", exact).astype(np.float64))
    assert np.abs(found - expit(exact)).max() <= 1 / 512 + 1e-6


def test_opacities_stay_inside_of_0_and_1():
    found = expit(_stored("opacities", [-1e38, -200, 0, 200, 1e38]))
    assert (found > 0).all()
    assert (found < 1).all()


def test_colours_are_right_to_1_in_512():
    exact = np.r_[np.linspace(-3, 3, 9973), 10.0 ** np.arange(1, 6), -1e4]
    assert _within(0.5 + SH_DC * _stored("constants", (exact - 0.5) / SH_DC), exact, 1 / 256)


def test_harmonics_are_right_to_1_in_512():
    exact = np.r_[np.linspace(-3, 3, 9973), 10.0 ** np.arange(1, 30), -1e4]
    assert _within(_stored("harmonics", exact), exact, 1 / 256)


def test_small_codes_of_both_signs_have_small_numbers():
    codes = rounding.codes_of_harmonics(np.array([0, -1, 1, -2, 2]) / 256)
    assert codes.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("name", ENCODINGS)
@given(values=st.lists(floats, max_size=20))
@settings(max_examples=200, deadline=None)
def test_any_number_is_stored_once_and_for_all(name, values):
    """What is decoded is finite and encodes to the same codes."""
    encode, _ = ENCODINGS[name]
    once = _stored(name, values)
    assert np.isfinite(once).all()
    np.testing.assert_array_equal(encode(once.astype(np.float64)), encode(np.asarray(values, np.float64)))
    np.testing.assert_array_equal(_stored(name, once), once)


@extreme(
    "radiance of 1e12 in a compact file",
    given="a colour of 1.05e5 on the perceptual scale",
    expected="within 1/512",
)
def test_radiance_of_any_size_keeps_its_share(got):
    colour = 1.055 * 1e12 ** (1 / 2.4) - 0.055
    found = 0.5 + SH_DC * float(_stored("constants", [(colour - 0.5) / SH_DC])[0])
    assert got(abs(found / colour - 1), ".5f") <= 1.01 / 512


@extreme("largest numbers in a compact file", given="harmonics and scales of 3.4e38", expected="finite")
def test_the_largest_numbers_stay_finite(got):
    found = [_stored(name, [_FLOAT32, -_FLOAT32]) for name in ENCODINGS]
    assert all(np.isfinite(values).all() for values in found)
    got("finite")
