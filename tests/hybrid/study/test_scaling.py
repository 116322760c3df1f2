"""Choices scaled in JOD: gradients, known qualities, coverage of the intervals, and published scales."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks.studies import agreement_with_alsarr, agreement_with_hdr_vdc
from compose.base.errors import UserError
from hybrid.study.observations import Choices
from hybrid.study.scaling import (
    SIGMA,
    agreement,
    count,
    most_likely,
    outliers,
    pooled,
    posterior,
    preference,
    scale,
)
from hybrid.study.simulated_observers import simulated_choices
from tests.conftest import REAL_DATA

_DATA = REAL_DATA / "data"
published = pytest.mark.skipif(not _DATA.is_dir(), reason="no data of people's choices beside the project")


def _choices(rows):
    observer, group, first, second, chosen = zip(*rows, strict=True)
    return Choices(*(np.array(part) for part in (observer, group, first, second)), np.array(chosen, bool))


@pytest.mark.parametrize("prior", ["jeffreys", "none"])
def test_the_gradient_by_finite_differences(prior):
    random = np.random.default_rng(0)
    pairs = np.array(list(combinations(range(5), 2)))
    wins, losses = random.integers(0, 6, (2, 3, len(pairs))).astype(float)
    quality = random.normal(0, 1.5, (3, 5))
    gradient = posterior(quality, pairs, wins, losses, prior)[1]
    for n in range(5):
        step = np.zeros(5)
        step[n] = 1e-5
        ends = [posterior(quality + sign * step, pairs, wins, losses, prior)[0] for sign in (1, -1)]
        np.testing.assert_allclose(gradient[:, n], (ends[0] - ends[1]) / 2e-5, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("prior", ["jeffreys", "none"])
def test_the_gradient_vanishes_at_the_most_likely_qualities(prior):
    counts = count(simulated_choices({"": {"a": 0.0, "b": 1.0, "c": 5.0}}, 9, 3, seed=1), "")
    wins, losses = counts.wins.sum(0)[None], counts.losses.sum(0)[None]
    found = most_likely(counts.pairs, wins, losses, 3, prior)
    assert np.abs(posterior(found, counts.pairs, wins, losses, prior)[1]).max() < 1e-5


def test_three_quarters_are_one_jod():
    rows = [(f"O{n % 20}", "", "ours", "other", n % 4 > 0) for n in range(4000)]
    found = scale(_choices(rows), reference="other", anchor=10)[0]
    assert found.conditions == ("other", "ours")
    np.testing.assert_allclose(found.jod, [10, 11], atol=2e-3)
    assert preference(1) == pytest.approx(0.75)


def test_the_likelihood_by_hand():
    """Without a prior, two conditions lie where their share of choices says."""
    counts = (np.array([[0, 1]]), np.array([[37.0]]), np.array([[13.0]]))
    found = most_likely(*counts, 2, prior="none")[0]
    assert found[0] - found[1] == pytest.approx(SIGMA * norm.ppf(37 / 50), abs=2e-3)


def test_the_prior_takes_away_bias():
    """Means of 400 small studies; choices of one observer may be unanimous."""
    random = np.random.default_rng(2)
    wins = random.binomial(12, preference(1.0), (400, 1)).astype(float)
    with_it, without_it = (
        most_likely(np.array([[0, 1]]), wins, 12 - wins, 2, prior) @ [1, -1] for prior in ("jeffreys", "none")
    )
    assert abs(with_it.mean() - 1) < 0.07 < without_it.mean() - 1


def test_unanimous_choices_stay_finite():
    rows = [(f"O{n}", "", "ours", "other", True) for n in range(5)]
    found = scale(_choices(rows))[0]
    low, high = found.interval()
    assert 1 < found.jod[1] - found.jod[0] < 6
    assert np.isfinite([low, high]).all()
    assert found.difference(1, 0).low < found.difference(1, 0).jod


_JODS = {"a": 0.0, "b": 0.5, "c": 1.0, "d": 2.0}


def test_known_differences_lie_in_their_intervals():
    """All six of 300 studies; of 1,000 studies of this kind, 95.7 % do."""
    names, inside = list(_JODS), []
    for seed in range(300):
        found = scale(simulated_choices({"": _JODS}, 13, 3, seed, lapse=0, spread=0.5))[0]
        for one, other in combinations(range(4), 2):
            true = _JODS[names[one]] - _JODS[names[other]]
            difference = found.difference(one, other)
            inside.append(difference.low <= true <= difference.high)
    assert 0.93 <= np.mean(inside) <= 0.97


def test_intervals_hold_where_nearly_all_choose_alike():
    """Leaving out observers alone finds 3 JOD in 73 % of such studies."""
    found = [
        scale(simulated_choices({"": {"a": 0.0, "b": 3.0}}, 13, 5, seed, lapse=0))[0].difference(1, 0)
        for seed in range(300)
    ]
    assert np.mean([difference.low <= 3 <= difference.high for difference in found]) >= 0.93


def _differences(jod, spread, count=500):
    """Differences of two conditions in studies of 13 observers and 6 trials; 1 JOD is the margin."""
    studies = (
        simulated_choices({"": {"a": jod, "b": 0.0}}, 13, 6, n, lapse=0, spread=spread) for n in range(count)
    )
    return [scale(choices)[0].difference(0, 1, margin=1.0) for choices in studies]


@pytest.mark.parametrize("spread", [0.0, 0.7])
def test_no_difference_is_called_one_in_at_most_5_of_100(spread):
    found = _differences(0.0, spread)
    wrong = np.mean([difference.p < 0.05 for difference in found])
    assert wrong <= 0.05
    # The test is the interval's.
    assert wrong == np.mean([not difference.low <= 0 <= difference.high for difference in found])
    assert np.mean([difference.equivalence_p < 0.05 for difference in found]) > 0.5


def test_a_difference_at_the_margin_is_called_equivalent_in_at_most_5_of_100():
    assert np.mean([difference.equivalence_p < 0.05 for difference in _differences(1.0, 0.7)]) <= 0.05


def test_observers_are_the_units():
    """The same answers ten times over say no more about people."""
    choices = simulated_choices({"": {"a": 0.0, "b": 0.5}}, 12, 4, seed=3, spread=1.0)
    tenfold = Choices(*(np.tile(part, 10) for part in list(vars(choices).values())[:5]))
    once, often = (scale(c)[0].difference(1, 0) for c in (choices, tenfold))
    assert often.high - often.low > 0.85 * (once.high - once.low)


def test_leaving_out_by_hand():
    choices = simulated_choices({"": {"a": 0.0, "b": 0.5, "c": 1.5}}, 6, 4, seed=3)
    found = scale(choices, reference="a")[0]
    kept = choices.observer != "O3"
    fewer = scale(Choices(*(part[kept] for part in list(vars(choices).values())[:5])), reference="a")[0]
    np.testing.assert_allclose(found.without[2], fewer.jod, atol=1e-5)
    assert found.jod[0] == 0
    assert found.interval()[0][0] == found.interval()[1][0] == 0
    by_hand = 5 / 6 * ((found.without - found.without.mean(0)) ** 2).sum(0)
    np.testing.assert_allclose(np.diag(found.over_observers), by_hand)


def test_groups_are_scaled_apart_and_averaged():
    choices = simulated_choices({"s": {"a": 0.0, "b": 1.0}, "t": {"a": 0.0, "b": 2.0}}, 15, 5, seed=4)
    scales = scale(choices, reference="a")
    mean = pooled(scales)
    assert [found.group for found in scales] == ["s", "t"]
    assert mean is not None
    np.testing.assert_allclose(mean.jod, (scales[0].jod + scales[1].jod) / 2)
    difference = mean.difference(1, 0)
    assert difference.low < 1.5 < difference.high
    assert difference.high - difference.low < np.mean([np.ptp(s.difference(1, 0)[1:3]) for s in scales])
    assert pooled(scales[:1]) is None


def test_what_cannot_be_scaled_is_refused():
    apart = [(o, "room", *pair, True) for o in "AB" for pair in (("a", "b"), ("c", "d"))]
    with pytest.raises(UserError, match="group 'room': no choice links 'a', 'b' with 'c', 'd'"):
        scale(_choices(apart))
    with pytest.raises(UserError, match="the choices: has one observer only"):
        scale(_choices([("A", "", "a", "b", True)]))
    pair = _choices([(o, "", "a", "b", True) for o in "AB"])
    with pytest.raises(UserError, match="has no reference 'c'; its conditions are: a, b"):
        scale(pair, reference="c")
    with pytest.raises(UserError, match="prior 'flat': must be jeffreys or none"):
        scale(pair, prior="flat")
    chain = [(o, "", f"c{n:02}", f"c{n + 1:02}", True) for o in "AB" for n in range(64)]
    with pytest.raises(UserError, match="has 65 conditions; at most 64"):
        scale(_choices(chain))


def test_who_chooses_the_worse_one_is_an_outlier():
    choices = simulated_choices({"": {"a": 0.0, "b": 2.0, "c": 4.0}}, 12, 4, seed=5)
    turned = np.where(choices.observer == "O07", ~choices.chosen_first, choices.chosen_first)
    choices = Choices(choices.observer, choices.group, choices.first, choices.second, turned)
    found = agreement(choices, scale(choices))
    assert outliers(found) == ["O07"]
    assert found["O07"] < np.log(0.5) < min(value for name, value in found.items() if name != "O07")


@published
def test_alsarr_is_scaled_as_its_authors_did():
    found = agreement_with_alsarr(_DATA)
    assert found["conditions"] == 108
    assert found["r"] >= 0.9999
    assert found["rms"] <= 0.03


@published
def test_hdr_vdc_is_scaled_as_its_authors_did():
    found = agreement_with_hdr_vdc(_DATA)
    assert found["conditions"] == 528
    assert found["r"] >= 0.995
    assert found["rms"] <= 0.36
