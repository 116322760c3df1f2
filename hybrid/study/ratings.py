"""Mean opinion scores of votes on a scale, and the screening of observers of Rec. ITU-R BT.500."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hybrid.study.observations import Names, Ratings

# Rec. ITU-R BT.500-13, annex 2, 2.3.1: kurtosis of votes that count as normal, and how far votes of others
# may lie.
_NORMAL_KURTOSIS = (2.0, 4.0)
_NORMAL_SPREADS, _OTHER_SPREADS = 2.0, np.sqrt(20.0)
# An observer is dropped with more far votes than this, if they lie on both sides alike.
_MOST_FAR, _LEAST_BIAS = 0.05, 0.3


def screening(ratings: Ratings) -> list[dict[str, Any]]:
    """Observer screening of Rec. ITU-R BT.500-13 (annex 2, 2.3.1): one row an observer, in order.

    A vote is far if it is at least 2 standard deviations from the mean of all votes for the same condition of
    the same scene, or sqrt(20), unless the kurtosis of these votes lies between 2 and 4. P and Q count an
    observer's far votes above and below. Dropped is who has (P + Q) / votes > 5 % and
    |P - Q| / (P + Q) < 30 %: whose votes are wild, rather than biased to one side.

    Returns:
        Rows of `observer`, `votes`, `above` (P), `below` (Q), `mean`, `sd` (None of one vote), and `dropped`.
    """
    names, observer = np.unique(ratings.observer, return_inverse=True)
    above, below = _far(ratings)
    rows = []
    for at, name in enumerate(names):
        own = observer == at
        votes, p, q = int(own.sum()), int(above[own].sum()), int(below[own].sum())
        dropped = (p + q) / votes > _MOST_FAR and abs(p - q) / (p + q) < _LEAST_BIAS
        mean, sd = _mean_and_sd(ratings.vote[own])
        row = {"observer": str(name), "votes": votes, "above": p, "below": q, "mean": mean, "sd": sd}
        rows.append(row | {"dropped": bool(dropped)})
    return rows


def _far(ratings: Ratings) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which votes (N,) lie far above and far below others for the same."""
    above, below = np.zeros((2, len(ratings.vote)), bool)
    shown = np.stack([ratings.scene, ratings.condition])
    names, cell = np.unique(shown, axis=1, return_inverse=True)
    for at in range(names.shape[1]):
        here = cell.ravel() == at
        votes = ratings.vote[here]
        mean, sd = _mean_and_sd(votes)
        if not sd:
            # All alike: none is far.
            continue
        low, high = _NORMAL_KURTOSIS
        normal = low <= stats.kurtosis(votes, fisher=False) <= high
        reach = sd * (_NORMAL_SPREADS if normal else _OTHER_SPREADS)
        above[here], below[here] = votes >= mean + reach, votes <= mean - reach
    return above, below


def opinion_scores(ratings: Ratings, level: float = 0.95) -> list[dict[str, Any]]:
    """Mean opinion scores of all votes, of each condition, and of each condition of each scene.

    The interval to report is that over observers: votes of one observer are not independent, so that counting
    them as such, as the formula of BT.500 does (mean -+ 1.96 sd / sqrt(votes), annex 2, 2.2), makes the
    interval narrower by every repetition. Both are given.

    Returns:
        Rows of `scene` and `condition` ("" for all), `observers`, `votes`, `mean` (of the observers' means),
        `low` and `high` of its interval with Student's t; `votes_mean`, `votes_sd`, `votes_low` and
        `votes_high` by BT.500. What one observer or one vote does not give is None.
    """
    keys = [("", ""), *(("", str(name)) for name in np.unique(ratings.condition))]
    pairs = np.unique(np.stack([ratings.scene, ratings.condition]), axis=1).T
    keys += [(str(scene), str(condition)) for scene, condition in pairs if scene]
    return [_score(ratings, scene, condition, level) for scene, condition in keys]


def _score(ratings: Ratings, scene: str, condition: str, level: float) -> dict[str, Any]:
    here = np.ones(len(ratings.vote), bool)
    if scene:
        here &= ratings.scene == scene
    if condition:
        here &= ratings.condition == condition
    votes = ratings.vote[here]
    means = observer_means(ratings.observer[here], votes)
    mean, sd = _mean_and_sd(means)
    votes_mean, votes_sd = _mean_and_sd(votes)
    low, high = _interval(mean, sd, len(means), stats.t.ppf(0.5 + level / 2, max(len(means) - 1, 1)))
    votes_low, votes_high = _interval(votes_mean, votes_sd, len(votes), stats.norm.ppf(0.5 + level / 2))
    return {
        "scene": scene,
        "condition": condition,
        "observers": len(means),
        "votes": len(votes),
        "mean": mean,
        "low": low,
        "high": high,
        "votes_mean": votes_mean,
        "votes_sd": votes_sd,
        "votes_low": votes_low,
        "votes_high": votes_high,
    }


def observer_means(observer: Names, vote: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean vote of each observer, in order of their names."""
    names, index = np.unique(observer, return_inverse=True)
    return np.bincount(index, vote, len(names)) / np.bincount(index, minlength=len(names))


def _mean_and_sd(values: NDArray[np.float64]) -> tuple[float, float | None]:
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else None


def _interval(
    mean: float, sd: float | None, count: int, quantile: float
) -> tuple[float | None, float | None]:
    if sd is None:
        return None, None
    half = float(quantile) * sd / np.sqrt(count)
    return float(mean - half), float(mean + half)
