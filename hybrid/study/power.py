"""How many observers a study needs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from compose.base.errors import UserError
from hybrid.study.observations import required

_MOST_OBSERVERS = 1 << 14


def observers_for_difference(d_z: float, alpha: float = 0.05, power: float = 0.8) -> int:
    """Observers for a paired t-test, of two sides, to find a difference of mean votes.

    `d_z` is Cohen's d of paired differences: their mean over their standard deviation over observers.
    UserError for a value out of range, or one that needs more than 8,192 observers.
    """
    _check(alpha, power)
    if not (math.isfinite(d_z) and d_z):
        raise UserError(f"effect {d_z:g}: must be a number other than 0")
    test: Any = required("statsmodels.stats.power", "power").TTestPower()
    # Two observers are the fewest that have a spread. Powers of far too many observers overflow.
    many = 2
    while test.power(abs(d_z), many, alpha) < power:
        many *= 2
        if many > _MOST_OBSERVERS:
            raise UserError(
                f"effect {d_z:g}: is too small; needs more than {_MOST_OBSERVERS // 2:,} observers"
            )
    return next(n for n in range(max(many // 2, 2), many + 1) if test.power(abs(d_z), n, alpha) >= power)


def observers_for_preference(
    probability: float, trials: int, alpha: float = 0.05, power: float = 0.8, spread: float = 0.0
) -> int:
    """Observers to find that one of two conditions is preferred, each judging the pair in so many trials.

    Observers are the units, as in the analysis: the t-test is of the shares of trials in which each prefers
    the condition. Their variance is probability * (1 - probability) / trials of chance, and of people.

    Args:
        probability: that a trial ends with the condition preferred, as .75 at 1 JOD.
        trials: of each observer.
        alpha: of the test.
        power: probability to find the preference.
        spread: standard deviation of the probabilities of single observers.

    UserError for a value out of range, or one that needs more than 8,192 observers.
    """
    if not 0 < probability < 1 or probability == 0.5:
        raise UserError(f"probability {probability:g}: must be between 0 and 1, and not .5")
    if trials < 1:
        raise UserError(f"trials {trials}: must be at least 1")
    if not 0 <= spread < 0.5:
        raise UserError(f"spread {spread:g}: must be at least 0, below .5")
    variance = probability * (1 - probability) / trials + spread**2
    return observers_for_difference((probability - 0.5) / float(np.sqrt(variance)), alpha, power)


def _check(alpha: float, power: float) -> None:
    for name, value in (("alpha", alpha), ("power", power)):
        if not 0 < value < 1:
            raise UserError(f"{name} {value:g}: must be between 0 and 1")
