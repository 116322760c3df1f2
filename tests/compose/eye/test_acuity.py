"""acuity models, against numbers worked by hand and published ones."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.acuity import (
    ACUITY_MODELS,
    acuity_model_named,
    continuous_level,
    fov_gs,
    geisler_perry,
    minimum_angle,
    with_saliency,
)
from compose.eye.stelacsf import stelacsf


def test_the_minimum_angle_of_resolution():
    """Eq. 6: 1/48 degree in the fovea, 1.32 arcmin more per degree."""
    np.testing.assert_allclose(minimum_angle(np.array([0.0, 10.0])), [1 / 48, 1 / 48 + 0.22])


def test_level_boundaries_by_hand():
    """a(10) = 0.24083; 2 a - w0 over m gives 20.947, 4 a 42.841, 8 a 86.629 degrees."""
    edge = float(fov_gs(np.array(10.0)))
    boundaries = np.array([10.0, 20.947, 42.841, 86.629])
    np.testing.assert_allclose(continuous_level(fov_gs(boundaries), edge, 4), [4, 3, 2, 1], atol=2e-4)
    # Printed with two decimals in the paper's terms.
    np.testing.assert_allclose(boundaries, [10, 20.95, 42.84, 86.6], atol=0.04)


def test_the_level_has_no_steps():
    eccentricity = np.linspace(0, 90, 5000)
    level = continuous_level(fov_gs(eccentricity), float(fov_gs(np.array(10.0))), 4)
    assert (np.diff(level) < 0).all()
    assert np.abs(np.diff(level)).max() < 0.03


@pytest.mark.parametrize(
    ("acuity_model", "expected"),
    [
        (fov_gs, [48.0, 4.15, 2.17, 1.47]),
        # Threshold contrast at 100 cd/m2 and 1 square degree; other fields and areas differ by a tenth.
        (stelacsf, [64.0, 9.0, 4.2, 2.1]),
        # e2 ln(64) / (alpha (e + e2)), by hand.
        (geisler_perry, [39.23, 7.337, 4.047, 2.794]),
    ],
)
def test_cutoffs_at_0_10_20_30_degrees(acuity_model, expected):
    np.testing.assert_allclose(acuity_model(np.array([0.0, 10, 20, 30])), expected, rtol=0.15)


@pytest.mark.parametrize("name", ACUITY_MODELS)
def test_laws_never_rise_and_stay_finite_numbers_or_unlimited(name):
    cutoff = ACUITY_MODELS[name].cutoff(np.linspace(0, 180, 400))
    assert not np.isnan(cutoff).any()
    assert (cutoff > 0.1).all()
    if name != "none":
        assert (np.diff(cutoff) <= 1e-9).all()


def test_saliency_raises_the_cutoff_by_up_to_two_fifths():
    np.testing.assert_allclose(with_saliency(np.array([5.0, 5, 5]), np.array([0.0, 0.5, 1])), [5, 6, 7])


def test_without_a_cutoff_all_is_finest():
    assert continuous_level(np.array([np.inf]), 0.5, 4)[0] == np.inf


def test_an_unknown_law_is_named():
    with pytest.raises(UserError, match="--acuity-model blur: must be fov-gs, stelacsf, geisler-perry, none"):
        acuity_model_named("blur")
