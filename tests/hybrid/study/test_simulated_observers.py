"""Made-up observers answer as often, and as the given qualities say."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.study.scaling import preference
from hybrid.study.simulated_observers import simulated_choices, simulated_ratings


def test_all_pairs_are_answered_by_everybody_from_both_sides():
    found = simulated_choices({"s": {"a": 0.0, "b": 1.0, "c": 2.0}, "t": {"a": 0.0, "b": 1.0}}, 6, 4, seed=0)
    assert len(found.observer) == 6 * 4 * (3 + 1)
    assert np.unique(found.observer).tolist() == [f"O{n}" for n in range(1, 7)]
    pair = np.sort(np.stack([found.first, found.second]), 0)
    here = (found.group == "s") & (found.observer == "O3") & (pair == [["b"], ["c"]]).all(0)
    assert sorted(found.first[here].tolist()) == ["b", "b", "c", "c"]


@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_choices_follow_the_qualities(spread):
    """Also of observers who differ, within 4 standard deviations of 4,000 observers."""
    found = simulated_choices({"": {"a": 0.0, "b": 1.0}}, 4000, 1, seed=1, lapse=0, spread=spread)
    share = np.mean((found.first == "b") == found.chosen_first)
    assert share == pytest.approx(preference(1), abs=4 * np.sqrt(0.1875 / 4000))


def test_lapses_are_chance():
    found = simulated_choices({"": {"a": 0.0, "b": 9.0}}, 2000, 1, seed=2, lapse=0.2)
    assert np.mean((found.first == "b") == found.chosen_first) == pytest.approx(0.9, abs=0.03)


def test_votes_follow_the_qualities():
    jods = {"s": {"same": 10.0, "worse": 7.0, "worst": 0.0}}
    found = simulated_ratings(jods, 300, 2, seed=3)
    means = [found.vote[found.condition == name].mean() for name in jods["s"]]
    assert set(found.vote) == {1, 2, 3, 4, 5}
    # The best and the worst are kept on the scale.
    assert 4.5 < means[0] < 5
    assert means[1] == pytest.approx(5 - 0.6 * 3, abs=0.1)
    assert 1 <= means[2] < 1.3


def test_the_seed_decides():
    jods = {"s": {"a": 10.0, "b": 8.0}}
    for simulated in (simulated_choices, simulated_ratings):
        one, again, other = (simulated(jods, 20, 3, seed) for seed in (1, 1, 2))
        answers = [list(vars(found).values())[-2].tolist() for found in (one, again, other)]
        assert answers[0] == answers[1] != answers[2]
