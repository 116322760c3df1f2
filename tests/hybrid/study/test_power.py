"""Numbers of observers: against tables, and against made-up studies."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.study.power import observers_for_difference, observers_for_preference
from hybrid.study.scaling import preference, scale
from hybrid.study.simulated_observers import simulated_choices


@pytest.mark.parametrize(("d_z", "observers"), [(0.2, 199), (0.5, 34), (-0.5, 34), (0.8, 15), (3.0, 4)])
def test_observers_of_the_usual_effects(d_z, observers):
    """As G*Power has them for a paired t-test of two sides."""
    assert observers_for_difference(d_z) == observers


def test_more_trials_and_fewer_demands_need_fewer_observers():
    once = observers_for_preference(0.75, 1)
    assert observers_for_preference(0.75, 4) < once
    assert observers_for_preference(0.75, 1, alpha=0.1) < once
    assert observers_for_preference(0.75, 1, power=0.9) > once
    assert observers_for_preference(0.75, 4, spread=0.2) > observers_for_preference(0.75, 4)
    assert observers_for_preference(0.25, 4) == observers_for_preference(0.75, 4)


def test_so_many_observers_find_the_preference():
    """In 80 % of studies, give or take three standard deviations of 200 of them."""
    observers = observers_for_preference(preference(0.5), 5)
    found = [
        scale(simulated_choices({"": {"a": 0.5, "b": 0.0}}, observers, 5, seed, lapse=0))[0].difference(0, 1)
        for seed in range(200)
    ]
    assert np.mean([difference.p < 0.05 for difference in found]) == pytest.approx(0.8, abs=0.085)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: observers_for_difference(0.0), "effect 0: must be a number other than 0"),
        (lambda: observers_for_difference(float("nan")), "effect nan: must be"),
        (
            lambda: observers_for_difference(0.001),
            "effect 0.001: is too small; needs more than 8,192 observers",
        ),
        (lambda: observers_for_difference(0.5, alpha=0.0), "alpha 0: must be between 0 and 1"),
        (lambda: observers_for_difference(0.5, power=1.0), "power 1: must be between 0 and 1"),
        (lambda: observers_for_preference(0.5, 3), "probability 0.5: must be between 0 and 1, and not .5"),
        (lambda: observers_for_preference(0.7, 0), "trials 0: must be at least 1"),
        (lambda: observers_for_preference(0.7, 1, spread=0.5), "spread 0.5: must be at least 0, below .5"),
    ],
)
def test_values_out_of_range_are_refused(call, said):
    with pytest.raises(UserError, match=said):
        call()
