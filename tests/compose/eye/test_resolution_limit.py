"""The acuity model fitted to people: its values, and people's own where the data lie beside the project."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import fit_acuity
from compose.eye import acuity
from compose.eye.acuity import ACUITY_MODELS, limit_sensitivity, resolution_limit
from tests.conftest import REAL_DATA

_DATA = REAL_DATA / "data"
of_people = pytest.mark.skipif(not _DATA.is_dir(), reason="no data of people's vision beside the project")


@pytest.fixture(scope="module")
def cutoffs():
    return fit_acuity.load_cutoffs(_DATA)


@pytest.fixture(scope="module")
def sensitivities():
    return fit_acuity.load_sensitivities(_DATA)


def test_cutoffs_do_not_change():
    found = resolution_limit(np.array([0.0, 10, 20, 30, 60]))
    np.testing.assert_allclose(found, [48.168, 19.562, 9.514, 5.579, 1.8025], rtol=1e-3)


def test_full_contrast_is_just_visible_at_the_cutoff():
    eccentricity = np.array([0.0, 3, 10, 25, 40])
    found = resolution_limit(eccentricity)
    np.testing.assert_array_less(limit_sensitivity(1.01 * found, eccentricity), 1)
    np.testing.assert_array_less(1, limit_sensitivity(0.99 * found, eccentricity))


def test_the_sensitivity_by_hand():
    """At 10 degrees and 8 cycles per degree; 62.01 x 0.5502 x 1.0642 x 8 in the fovea by stelaCSF."""
    expected = 290.4 * 10 ** (1.0268 - (0.0064992 + 0.0316258 * 8**0.721685) * 10 - (8 / 29.0309) ** 2)
    found = limit_sensitivity(np.array(8.0), np.array(10.0))
    assert found == pytest.approx(expected, rel=0.01)


def test_dimmer_displays_show_a_little_less():
    frequency = np.exp2(np.linspace(-2, 6, 2000))
    dim, bright = (
        frequency[np.flatnonzero(limit_sensitivity(frequency, np.zeros(1), luminance) >= 1)[-1]]
        for luminance in (10.0, 1000.0)
    )
    middle = resolution_limit(np.zeros(1))[0]
    assert 0.93 * middle < dim < 0.97 * middle
    assert middle < bright < 1.03 * middle


def test_shares_of_observers_lie_in_order_around_the_median():
    eccentricity = np.linspace(0, 90, 91)
    few, half, most = (resolution_limit(eccentricity, share) for share in (0.05, 0.5, 0.95))
    assert (few <= half).all()
    assert (half < most).all()
    # A standard deviation of 0.181 octaves in the fovea, 1.645 of them.
    assert most[0] / half[0] == pytest.approx(2 ** (0.181 * 1.645), rel=1e-3)
    # Not wider beyond the 20 degrees to which people were measured.
    np.testing.assert_allclose((most / half)[40:], (most / half)[20])


@of_people
def test_it_is_as_near_to_people_as_their_own_medians(cutoffs):
    found = fit_acuity.compared(cutoffs, cutoffs.errors(resolution_limit(cutoffs.eccentricity)))
    assert found["rms"] < 0.41
    assert np.abs(found["means"]).max() < 0.05


@of_people
def test_no_other_model_is_as_near(cutoffs):
    names = [name for name in ACUITY_MODELS if name != "none" and not name.startswith("resolution-limit")]
    for name in names:
        cutoff = ACUITY_MODELS[name].cutoff(cutoffs.eccentricity)
        assert fit_acuity.compared(cutoffs, cutoffs.errors(cutoff))["rms"] > 0.5, name


@of_people
def test_the_parameters_are_those_of_the_fit(cutoffs, sensitivities):
    parameters, _ = fit_acuity.fit(cutoffs, sensitivities)
    eccentricity = np.array([0.0, 5, 10, 20, 30, 50])
    refitted = fit_acuity.limits(parameters, eccentricity)
    np.testing.assert_allclose(resolution_limit(eccentricity), refitted, rtol=0.01)
    errors = cutoffs.errors(fit_acuity.limits(parameters, cutoffs.eccentricity))
    found = fit_acuity.spread(cutoffs, errors)
    np.testing.assert_allclose(found, acuity._LIMIT_SPREAD[:2], rtol=0.01)


@of_people
def test_people_who_were_left_out_are_foretold(cutoffs, sensitivities):
    found = fit_acuity.compared(cutoffs, fit_acuity.left_out(cutoffs, sensitivities))
    assert found["rms"] <= 0.42
    assert np.abs(found["means"]).max() < 0.1


@of_people
def test_sensitivities_off_the_fovea_are_within_the_spread_of_studies(cutoffs, sensitivities):
    parameters, factors = fit_acuity.fit(cutoffs, sensitivities)
    errors = sensitivities.errors(parameters, factors)
    for number, name in enumerate(sensitivities.names):
        own = errors[(sensitivities.study == number) & (sensitivities.eccentricity > 0)]
        if len(own):
            assert own.std() < 0.2, name


@of_people
def test_shares_of_observers_are_those_of_people(cutoffs):
    for share in (0.25, 0.75, 0.95):
        under = cutoffs.errors(resolution_limit(cutoffs.eccentricity, share)) > 0
        # Of 50 cut-offs, two standard deviations of a binomial share.
        assert abs(under.mean() - share) < 2 * np.sqrt(share * (1 - share) / len(under)) + 0.02
