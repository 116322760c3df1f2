"""Mean opinion scores and screening by hand, and of votes with the moments of FPC's study."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest
from scipy import stats

from hybrid.study.observations import Ratings, without
from hybrid.study.ratings import opinion_scores, screening
from hybrid.study.simulated_observers import simulated_ratings

# Table 3 of FPC: mean and standard deviation of 15 votes of each of 11 people.
_FPC = (
    (4.33, 0.49), (4.27, 0.59), (4.13, 1.13), (5.0, 0.0), (4.47, 0.92), (4.2, 0.77),
    (3.93, 1.22), (4.0, 1.07), (4.27, 0.7), (4.47, 1.19), (5.0, 0.0),
)  # fmt: skip


def _with_moments(mean, sd):
    """15 votes from 1 to 5 of a mean and a standard deviation, to two digits."""
    every = combinations_with_replacement((1.0, 2.0, 3.0, 4.0, 5.0), 15)
    return min(every, key=lambda votes: abs(np.mean(votes) - mean) + abs(np.std(votes, ddof=1) - sd))


@pytest.fixture(scope="module")
def fpc():
    """11 observers x 5 pairs x 3, in random order."""
    random = np.random.default_rng(0)
    votes = [random.permutation(_with_moments(*moments)) for moments in _FPC]
    observer = np.repeat([f"P{n:02}" for n in range(1, 12)], 15)
    scene = np.tile([f"pair {n}" for n in range(1, 6)], 33)
    return Ratings(observer, scene, np.full(165, "foveated"), np.concatenate(votes))


def test_fpc_is_found_again(fpc):
    score = opinion_scores(fpc)[0]
    assert (score["observers"], score["votes"]) == (11, 165)
    assert round(score["mean"], 2) == round(score["votes_mean"], 2) == 4.37
    # As FPC has it, over votes; over people, who differ, it is wider.
    assert (round(score["votes_low"], 2), round(score["votes_high"], 2)) == (4.23, 4.50)
    assert score["low"] < score["votes_low"]
    assert score["high"] > score["votes_high"]


def test_fpc_screens_nobody_out(fpc):
    rows = screening(fpc)
    assert [round(row["mean"], 2) for row in rows] == [mean for mean, _ in _FPC]
    assert not any(row["dropped"] for row in rows)


def test_scores_equal_those_of_scipy():
    ratings = simulated_ratings({"a": {"x": 9.0, "y": 7.0}, "b": {"x": 8.0, "y": 6.0}}, 7, 3, seed=1)
    rows = {(row["scene"], row["condition"]): row for row in opinion_scores(ratings, 0.9)}
    assert list(rows) == [("", ""), ("", "x"), ("", "y"), ("a", "x"), ("a", "y"), ("b", "x"), ("b", "y")]
    here = (ratings.scene == "a") & (ratings.condition == "y")
    votes, row = ratings.vote[here], rows["a", "y"]
    means = [votes[ratings.observer[here] == name].mean() for name in np.unique(ratings.observer)]
    low, high = stats.t.interval(0.9, 6, np.mean(means), stats.sem(means))
    assert (row["low"], row["high"]) == pytest.approx((low, high))
    low, high = stats.norm.interval(0.9, votes.mean(), stats.sem(votes))
    assert (row["votes_low"], row["votes_high"]) == pytest.approx((low, high))


def test_one_vote_has_no_interval():
    one = Ratings(np.array(["A"]), np.array([""]), np.array(["ours"]), np.array([4.0]))
    assert [row["low"] for row in opinion_scores(one)] == [None, None]
    assert screening(one)[0]["sd"] is None


def _twenty(last):
    """Votes of twenty observers for 10 conditions, around 3, and those of one more."""
    random = np.random.default_rng(5)
    votes = np.vstack([np.clip(np.rint(random.normal(3, 0.9, (20, 10))), 1, 5), last])
    observer = np.repeat([f"O{n:02}" for n in range(21)], 10)
    condition = np.tile([f"c{n}" for n in range(10)], 21)
    return Ratings(observer, np.full(210, ""), condition, votes.ravel())


def test_wild_votes_are_screened_out_and_biased_ones_are_kept():
    wild, low = _twenty([1.0, 5.0] * 5), _twenty([1.0] * 10)
    found = screening(wild)[-1]
    # Where the kurtosis says so, far is farther than 1 and 5 are.
    assert (found["above"], found["below"], found["dropped"]) == (3, 3, True)
    found = screening(low)[-1]
    assert found["below"] >= 5
    assert not found["dropped"]
    kept = without(wild, ["O20"])
    assert len(kept.vote) == 200
    assert "O20" not in kept.observer


def test_the_kurtosis_decides_how_far_is_far():
    """Twenty threes and a 5 have a kurtosis of 19, where far is sqrt(20) deviations; the 5 is 4.36 away."""
    one = Ratings(
        np.array([f"O{n:02}" for n in range(21)]), *np.full((2, 21), "x"), np.array([3.0] * 20 + [5])
    )
    assert screening(one)[-1]["above"] == 0
    # Of 30 it is 5.2 deviations away.
    more = Ratings(
        np.array([f"O{n:02}" for n in range(30)]), *np.full((2, 30), "x"), np.array([3.0] * 29 + [5])
    )
    assert screening(more)[-1]["above"] == 1


def test_votes_all_alike_are_never_far():
    alike = Ratings(np.array(["A", "B", "C"]), *np.full((2, 3), "x"), np.full(3, 4.0))
    assert not any(row["above"] or row["below"] or row["dropped"] for row in screening(alike))
