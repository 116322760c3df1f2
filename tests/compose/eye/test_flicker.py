"""Sensitivity to flicker: its values, and people's own where the data lie beside the project."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from benchmarks import fit_flicker
from compose.eye.flicker import FLICKER, flicker_sensitivity
from tests.conftest import REAL_DATA
from tests.extremes import extreme

_DATA = REAL_DATA / "data"
of_people = pytest.mark.skipif(not _DATA.is_dir(), reason="no data of people's vision beside the project")
FREQUENCIES = np.linspace(0.5, 120, 2391)


def test_the_sensitivity_by_hand():
    """At 10 Hz, 20 degrees, 50 cd/m2 and 4 square degrees, in plain complex numbers."""
    gain, critical, fall, constant, per_decade, per_degree, weight = FLICKER
    speed = (1 - per_decade * math.log10(2)) * (1 + 20 * per_degree)
    turn = 2 * math.pi * 10 * constant / speed
    response = abs(cmath.exp(-9 * cmath.log(1 + 1j * turn)) - weight / (1 + 1.33j * turn) ** 10)
    expected = 10 ** (gain - 20 * fall) * math.sqrt(critical * 4 / (critical + 4)) * response
    found = flicker_sensitivity(np.array([10.0]), 20.0, 50.0, 4.0)
    assert found[0] == pytest.approx(expected, rel=1e-9)


def fastest(eccentricity: float, luminance: float, area: float) -> float:
    """Hz up to which full contrast is seen."""
    seen = flicker_sensitivity(FREQUENCIES, eccentricity, luminance, area) >= 1
    return float(FREQUENCIES[np.flatnonzero(seen)[-1]])


def test_the_fastest_that_is_seen_rises_with_the_logarithm_of_the_luminance():
    """The law of Ferry and Porter: the same for every factor of 10."""
    found = [fastest(0.0, luminance, 0.8) for luminance in (1.0, 10.0, 100.0, 1000.0)]
    assert min(np.diff(found)) > 5
    np.testing.assert_allclose(np.diff(found), np.diff(found).mean(), rtol=0.15)


def test_flicker_is_seen_faster_aside_and_less_contrast_of_it_in_the_fovea():
    assert fastest(30.0, 10.0, 7.0) > fastest(0.0, 10.0, 7.0) + 5
    slow = flicker_sensitivity(np.array([5.0]), np.array([0.0, 10, 30, 60]), 100.0, 1.0)
    assert (np.diff(slow) < 0).all()


@pytest.mark.parametrize(
    "stimulus",
    [
        pytest.param(stimulus, marks=extreme(f"flicker, {name}", given=str(stimulus), expected="0 or more"))
        for name, stimulus in (
            ("behind the head", (10.0, 180.0, 100.0, 1.0)),
            ("in the dark", (10.0, 0.0, 1e-12, 1.0)),
            ("in the sun", (10.0, 0.0, 1e9, 1.0)),
            ("of a point", (10.0, 0.0, 100.0, 1e-12)),
            ("of the whole field", (10.0, 0.0, 100.0, 1e12)),
            ("of a million Hz", (1e6, 10.0, 100.0, 1.0)),
        )
    ],
)
def test_the_sensitivity_stays_a_number(stimulus, got):
    frequency, *rest = stimulus
    found = float(flicker_sensitivity(np.array([frequency]), *rest)[0])
    assert 0 <= found < 1e6
    got(f"{found:.3g}")


@of_people
def test_people_see_as_the_model_does():
    """Within a third of a decade of each study but for one factor; off the fovea on the average, too."""
    thresholds = fit_flicker.load(_DATA)
    assert (len(thresholds.study), (thresholds.eccentricity > 0).sum()) == (460, 163)
    studies = fit_flicker.compared(thresholds, np.array(FLICKER))
    assert max(study["rms"] for study in studies.values()) < 0.35
    off_axis = [study["off_axis"] for study in studies.values() if study["off_axis"] is not None]
    assert len(off_axis) == 3
    assert max(map(abs, off_axis)) < 0.05
    assert abs(studies["yancheng2024"]["factor"]) < 0.05


@of_people
def test_the_parameters_are_those_of_the_fit():
    np.testing.assert_allclose(fit_flicker.fit(fit_flicker.load(_DATA)), FLICKER, rtol=0.02)
