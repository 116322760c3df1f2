"""Acuity models, against values worked out by hand; the cut-off of stelaCSF."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.acuity import (
    ACUITY_MODELS,
    DEFAULT_ACUITY_MODEL,
    acuity_model_named,
    fov_gs,
    geisler_perry,
    stelacsf,
)


def test_the_minimum_angle_of_resolution():
    """Eq. 6: 1/48 degree in the fovea, 1.32 arcmin more per degree."""
    np.testing.assert_allclose(1 / fov_gs(np.array([0.0, 10.0])), [1 / 48, 1 / 48 + 0.22])


def test_level_boundaries_of_fov_gs():
    """a(10) = 0.24083; (2 a - w0) / m gives 20.947, 4 a 42.841, 8 a 86.629 degrees.

    The paper prints 20.95, 42.84 and 86.6. At each of them the cut-off is half of that at the one before.
    """
    cutoff = fov_gs(np.array([10.0, 20.947, 42.841, 86.629]))
    np.testing.assert_allclose(cutoff[0], 1 / 0.24083, rtol=1e-4)
    np.testing.assert_allclose(cutoff[1:] / cutoff[:-1], 0.5, rtol=1e-4)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("fov-gs", [48.0, 4.1522, 2.1699, 1.4688]),
        # e2 ln(64) / (alpha (e + e2)).
        ("geisler-perry", [39.235, 7.3365, 4.0466, 2.7938]),
        ("none", [np.inf] * 4),
    ],
)
def test_cutoffs_at_0_10_20_30_degrees(name, expected):
    np.testing.assert_allclose(ACUITY_MODELS[name].cutoff(np.array([0.0, 10, 20, 30])), expected, rtol=1e-4)


def test_fovvideovdp_sees_what_the_metric_does():
    """Its own table, at full contrast."""
    found = ACUITY_MODELS["fovvideovdp"].cutoff(np.array([0.0, 10, 20, 30]))
    np.testing.assert_allclose(found, [32, 14.3, 10.3, 8.4], rtol=0.02)


def test_geisler_perry_sees_full_contrast_at_the_cutoff():
    """Their contrast threshold CT0 exp(alpha f (e + e2) / e2) is 1 there."""
    eccentricity = np.linspace(0, 80, 50)
    threshold = np.exp(0.106 * geisler_perry(eccentricity) * (eccentricity + 2.3) / 2.3) / 64
    np.testing.assert_allclose(threshold, 1)


@pytest.mark.parametrize("name", ACUITY_MODELS)
def test_cutoffs_never_rise_and_are_never_nan(name):
    cutoff = ACUITY_MODELS[name].cutoff(np.linspace(0, 180, 400))
    assert not np.isnan(cutoff).any()
    assert (cutoff > 0.1).all()
    if name != "none":
        assert (np.diff(cutoff) <= 1e-9).all()


def test_models_by_name():
    assert acuity_model_named("fov-gs").relative
    assert not acuity_model_named("geisler-perry").relative
    assert DEFAULT_ACUITY_MODEL in ACUITY_MODELS


def test_an_unknown_model_is_refused_by_name():
    with pytest.raises(UserError, match=r"^acuity model blur: must be fov-gs, .*, none$"):
        acuity_model_named("blur")


def test_cutoffs_are_near_published_acuity():
    """Full contrast at 100 cd/m2 and 1 square degree; fields and areas of other studies differ by a tenth."""
    np.testing.assert_allclose(stelacsf(np.array([0.0, 10, 20, 30])), [64.0, 9.0, 4.2, 2.1], rtol=0.15)


def test_cutoffs_do_not_change():
    """Values of this implementation, whose constants are those of the authors' fit of 2022-01-26."""
    expected = [43.2611466569, 20.1122139923, 10.1964850186, 4.3469394501, 2.1361308161]
    np.testing.assert_allclose(stelacsf(np.array([2.0, 5, 10, 20, 30])), expected, rtol=1e-8)


def test_the_cutoff_stays_within_its_limits():
    found = stelacsf(np.array([0.0, 44, 60, 120, 170]))
    assert found[0] == pytest.approx(64)
    assert (found[2:] == 0.5).all()
    assert found[1] >= 0.5


def test_between_its_tabulated_eccentricities_the_cutoff_is_geometric():
    """The table has steps of a quarter of a degree."""
    left, middle, right = stelacsf(np.array([10.0, 10.125, 10.25]))
    np.testing.assert_allclose(middle**2, left * right)
    assert left > right
