"""stelaCSF: the cut-off over eccentricity."""

from __future__ import annotations

import numpy as np
import pytest

from compose.eye.acuity import stelacsf


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
