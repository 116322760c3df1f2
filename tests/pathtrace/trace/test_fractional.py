"""Sample counts whose mean is no whole number."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.trace.film import fractional_counts


def test_whole_numbers_need_no_array():
    assert fractional_counts(4, 10, 0) == 4
    assert fractional_counts(3.0, 10, 0) == 3


@pytest.mark.parametrize(
    ("spp", "few", "many"), [(2.3, 70, 30), (1.5, 50, 50), (6.99, 1, 99), (1.001, 100, 0)]
)
def test_the_mean_is_met_by_the_numbers_below_and_above(spp, few, many):
    counts = fractional_counts(spp, 100, seed=5)
    below = int(spp)
    assert counts.dtype == np.int64
    assert [int((counts == below).sum()), int((counts == below + 1).sum())] == [few, many]


def test_every_position_gets_the_larger_number_equally_often():
    runs = np.array([fractional_counts(1.25, 16, seed) for seed in range(400)]) - 1
    assert np.array_equal(fractional_counts(1.25, 16, 3), fractional_counts(1.25, 16, 3))
    # Binomial with 400 draws of 1 / 4: standard deviation 8.7 around 100.
    assert (np.abs(runs.sum(axis=0) - 100) < 4 * 8.7).all()
