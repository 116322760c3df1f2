"""Quality in just-objectionable differences (JOD) from choices between two: Thurstone's case V.

A condition of quality q is preferred over one of quality r with the probability Phi((q - r) / 1.4826), so
that a difference of 1 JOD is preferred in 75 % of the trials (Perez-Ortiz and Mantiuk 2017, "A practical
guide and software for analysing pairwise comparison experiments", arXiv 1712.03686, section 3). Qualities
maximize the likelihood of all choices times Jeffreys' prior (Firth 1993, "Bias reduction of maximum
likelihood estimates"), which takes away the first order of the bias of few trials, and keeps unanimous
choices finite.

Intervals are of two kinds, of which the wider one counts. One leaves out one observer after the other (the
jackknife), so that the trials of an observer need not be independent, and takes the quantiles of Student's t
with one degree of freedom less than there are observers, as is done for few clusters (Bell and McCaffrey
2002, "Bias reduction in standard errors for linear regression with multi-stage samples"). Where nearly all
choose alike, the few who do not make it too narrow; the other one, from the expected information, is right
for independent trials. Percentiles of bootstraps over a dozen observers contain the truth in 86 to 92 instead
of 95 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.sparse.csgraph import connected_components
from scipy.special import log_ndtr, ndtr, ndtri

from compose.base.errors import UserError
from hybrid.study.observations import Choices

Floats = NDArray[np.float64]
# In JOD, one or an array of them.
Quality = TypeVar("Quality", float, Floats)
# JOD: the standard deviation of the difference of two qualities as they are seen, at which 1 JOD is 75 %.
SIGMA = float(1 / ndtri(0.75))
PRIORS = ("jeffreys", "none")
# Of a group; memory grows with the fourth power.
_MOST_CONDITIONS = 64
# A Gaussian prior of 32 JOD around a group's mean: nothing where data are, finite where all are unanimous.
_RIDGE = 1e-3
_MOST_STEPS, _LONGEST_STEP, _CONVERGED = 200, 1.5, 1e-6


class Difference(NamedTuple):
    """Difference of two conditions in JOD, its interval, and the p-value of there being none."""

    jod: float
    low: float
    high: float
    p: float
    equivalence_p: float


@dataclass(frozen=True)
class Scale:
    """Qualities of a group's conditions in JOD.

    Args:
        group: its name.
        conditions: their names, in order.
        observers: their names, in order.
        jod: qualities (C,).
        without: qualities without each of the observers (O, C).
        independent: covariance of the qualities (C, C) if trials are independent.
    """

    group: str
    conditions: tuple[str, ...]
    observers: tuple[str, ...]
    jod: Floats
    without: Floats
    independent: Floats

    @cached_property
    def over_observers(self) -> Floats:
        """Covariance of the qualities (C, C) over observers (Efron and Tibshirani 1993, equation 11.5)."""
        count = len(self.observers)
        offsets = self.without - self.without.mean(0)
        return (count - 1) / count * offsets.T @ offsets

    def interval(self, level: float = 0.95) -> tuple[Floats, Floats]:
        """Lower and upper ends (C,) of the intervals of the qualities."""
        half = np.array([self._half(row, level) for row in np.eye(len(self.jod))])
        return self.jod - half, self.jod + half

    def difference(self, first: int, second: int, level: float = 0.95, margin: float = 0.25) -> Difference:
        """How much better the first of two conditions, by their indices, is than the second.

        `equivalence_p` is of two one-sided tests that they differ by less than the margin (Schuirmann 1987).
        """
        jod = float(self.jod[first] - self.jod[second])
        contrast = np.zeros(len(self.jod))
        contrast[first], contrast[second] = 1, -1
        half, size = self._half(contrast, level), abs(jod)
        p = min(2 * self._tail(contrast, size), 1.0)
        return Difference(jod, jod - half, jod + half, p, self._tail(contrast, margin - size))

    def _errors(self, contrast: Floats) -> tuple[float, float]:
        """Standard errors of a weighted sum of the qualities, over observers and over trials."""
        # Of the reference's own quality, rounding may make a negative variance.
        over, independent = (
            max(float(contrast @ covariance @ contrast), 0.0)
            for covariance in (self.over_observers, self.independent)
        )
        return over**0.5, independent**0.5

    def _half(self, contrast: Floats, level: float) -> float:
        """Half the width of a weighted sum's interval."""
        over, independent = self._errors(contrast)
        tail = 0.5 + level / 2
        return float(
            max(stats.t.ppf(tail, len(self.observers) - 1) * over, stats.norm.ppf(tail) * independent)
        )

    def _tail(self, contrast: Floats, distance: float) -> float:
        """Probability that chance alone carries a weighted sum so far."""
        over, independent = np.maximum(self._errors(contrast), np.finfo(float).tiny)
        return float(
            max(stats.t.sf(distance / over, len(self.observers) - 1), stats.norm.sf(distance / independent))
        )


@dataclass(frozen=True)
class Counts:
    """Counted choices of a group: `pairs` (P, 2) of conditions; `wins`, `losses` (O, P) of the first."""

    conditions: tuple[str, ...]
    observers: tuple[str, ...]
    pairs: NDArray[np.int64]
    wins: Floats
    losses: Floats


def count(choices: Choices, group: str) -> Counts:
    """Counts the choices of one group; UserError if conditions are too many, or not linked by choices."""
    here = choices.group == group
    # Names in order, and their indices in the rows.
    conditions, both = np.unique(np.stack([choices.first[here], choices.second[here]]), return_inverse=True)
    observers, observer = np.unique(choices.observer[here], return_inverse=True)
    size = len(conditions)
    if size > _MOST_CONDITIONS:
        raise UserError(
            f"{_named(group)}: has {size} conditions; at most {_MOST_CONDITIONS} are scaled together"
        )
    first, second = both.reshape(2, -1)
    swapped = first > second
    chosen = choices.chosen_first[here] ^ swapped
    keys, pair = np.unique(
        np.where(swapped, second * size + first, first * size + second), return_inverse=True
    )
    wins, losses = np.zeros((2, len(observers), len(keys)))
    np.add.at(wins, (observer, pair), chosen)
    np.add.at(losses, (observer, pair), ~chosen)
    pairs = np.stack([keys // size, keys % size], 1)
    graph = np.zeros((size, size))
    graph[pairs[:, 0], pairs[:, 1]] = 1
    parts, part = connected_components(graph, directed=False)
    if parts > 1:
        names = [", ".join(repr(str(name)) for name in conditions[part == n][:3]) for n in range(2)]
        raise UserError(
            f"{_named(group)}: no choice links {names[0]} with {names[1]}; conditions must be compared, "
            "directly or through others"
        )
    return Counts(tuple(conditions.tolist()), tuple(observers.tolist()), pairs, wins, losses)


def _named(group: str) -> str:
    return f"group {group!r}" if group else "the choices"


def scale(
    choices: Choices, reference: str | None = None, anchor: float = 0.0, prior: str = "jeffreys"
) -> list[Scale]:
    """Scales each group of the choices by itself; the groups in order.

    Args:
        choices: by at least two observers in each group.
        reference: condition that has the quality `anchor`; otherwise the mean of a group's conditions has it.
        anchor: JOD, as 10 for a scale of quality, or 0 for one of just noticeable differences (JND).
        prior: "jeffreys", or "none": a group in which one condition always wins is then far away, not well
            placed.

    UserError for a group with one observer, without the reference, of conditions that were never compared
    with one another even through others, or of more than 64 conditions.
    """
    if prior not in PRIORS:
        raise UserError(f"prior {prior!r}: must be {' or '.join(PRIORS)}")
    return [
        _scaled(count(choices, str(g)), str(g), reference, anchor, prior) for g in np.unique(choices.group)
    ]


def _scaled(counts: Counts, group: str, reference: str | None, anchor: float, prior: str) -> Scale:
    if len(counts.observers) < 2:
        raise UserError(f"{_named(group)}: has one observer only; at least two are needed")
    if reference is not None and reference not in counts.conditions:
        known = ", ".join(counts.conditions[:5])
        raise UserError(f"{_named(group)}: has no reference {reference!r}; its conditions are: {known}")
    wins, losses = (np.vstack([n.sum(0), n.sum(0) - n]) for n in (counts.wins, counts.losses))
    found = most_likely(counts.pairs, wins, losses, len(counts.conditions), prior)
    at = slice(None) if reference is None else [counts.conditions.index(reference)]
    information = posterior(found[:1], counts.pairs, wins[:1], losses[:1], prior)[2][0]
    anchored = np.eye(len(found[0]))
    anchored[:, at] -= 1 / len(anchored[0, at])
    independent = anchored @ np.linalg.inv(information) @ anchored.T
    found = anchor + found @ anchored.T
    return Scale(group, counts.conditions, counts.observers, found[0], found[1:], independent)


def most_likely(
    pairs: NDArray[np.int64], wins: Floats, losses: Floats, conditions: int, prior: str = "jeffreys"
) -> Floats:
    """Qualities (B, C) of highest posterior density for B sets of counts (B, P), each with a mean of 0.

    Fisher scoring of all sets at once: the gradient times the inverse of the expected information.
    """
    quality = np.zeros((len(wins), conditions))
    # Sets that still move.
    moving = np.arange(len(wins))
    for _ in range(_MOST_STEPS):
        _, gradient, information = posterior(quality[moving], pairs, wins[moving], losses[moving], prior)
        step = np.linalg.solve(information, gradient[:, :, None])[:, :, 0]
        longest = np.abs(step).max(1, keepdims=True)
        step *= np.minimum(1, _LONGEST_STEP / np.maximum(longest, _CONVERGED))
        quality[moving] += step
        moving = moving[longest[:, 0] > _CONVERGED]
        if not len(moving):
            break
    return quality


def posterior(
    quality: Floats, pairs: NDArray[np.int64], wins: Floats, losses: Floats, prior: str
) -> tuple[Floats, Floats, Floats]:
    """Log posterior density (B,), its gradient (B, C), and the expected information (B, C, C).

    The density is of the qualities up to a common offset; the information has a 1 added to its eigenvalue of
    that offset, so that it can be inverted.
    """
    size = quality.shape[1]
    design = np.zeros((len(pairs), size))
    design[np.arange(len(pairs)), pairs[:, 0]] = 1 / SIGMA
    design[np.arange(len(pairs)), pairs[:, 1]] = -1 / SIGMA
    products = (design[:, :, None] * design[:, None, :]).reshape(len(pairs), -1)
    z = quality @ design.T
    won, lost = log_ndtr(z), log_ndtr(-z)
    # Inverse Mills ratios: phi(z) / Phi(z), and phi(z) / Phi(-z).
    log_phi = -0.5 * (z * z + np.log(2 * np.pi))
    up, down = np.exp(log_phi - won), np.exp(log_phi - lost)
    weight = (wins + losses) * up * down
    centred = np.eye(size) - 1 / size
    information = (weight @ products).reshape(-1, size, size) + _RIDGE * centred + 1 / size
    density = (wins * won + losses * lost).sum(1) - 0.5 * _RIDGE * ((quality @ centred) ** 2).sum(1)
    slope = wins * up - losses * down
    if prior == "jeffreys":
        # Half the logarithm of the determinant; its derivative is by the leverages of the pairs (Firth 1993,
        # 4.1).
        density += 0.5 * np.linalg.slogdet(information)[1]
        inverse = np.linalg.inv(information).reshape(len(quality), -1)
        slope += 0.5 * weight * (inverse @ products.T) * (down - up - 2 * z)
    return density, slope @ design - _RIDGE * quality @ centred, information


def pooled(scales: Sequence[Scale]) -> Scale | None:
    """Mean of the scales of several groups; None unless there are several, of the same conditions."""
    if len(scales) < 2 or len({found.conditions for found in scales}) > 1:
        return None
    observers = sorted({name for found in scales for name in found.observers})
    without = np.empty((len(observers), len(scales), len(scales[0].jod)))
    for at, found in enumerate(scales):
        # A group that an observer did not take part in stays as it is without them.
        without[:, at] = found.jod
        without[np.searchsorted(observers, found.observers), at] = found.without
    jod = np.mean([found.jod for found in scales], axis=0)
    independent = np.sum([found.independent for found in scales], axis=0) / len(scales) ** 2
    return Scale("", scales[0].conditions, tuple(observers), jod, without.mean(1), independent)


def preference(jod: Quality) -> Quality:
    """Probability that a condition which is so much better is preferred."""
    found: Quality = ndtr(jod / SIGMA)
    return found


def agreement(choices: Choices, scales: Sequence[Scale]) -> dict[str, float]:
    """Mean log-likelihood of a choice of each observer, by the qualities that all others found.

    As in the analysis of outliers of Perez-Ortiz and Mantiuk (2017, section 5), but per choice, so that
    observers who made different numbers of them can be compared. The logarithm of one half, -.69, is mere
    guessing.
    """
    sums: dict[str, float] = {}
    numbers: dict[str, float] = {}
    for found in scales:
        counts = count(choices, found.group)
        first, second = counts.pairs.T
        z = (found.without[:, first] - found.without[:, second]) / SIGMA
        likelihood = (counts.wins * log_ndtr(z) + counts.losses * log_ndtr(-z)).sum(1)
        total = (counts.wins + counts.losses).sum(1)
        for name, value, number in zip(found.observers, likelihood, total, strict=True):
            sums[name] = sums.get(name, 0.0) + float(value)
            numbers[name] = numbers.get(name, 0.0) + float(number)
    return {name: sums[name] / numbers[name] for name in sorted(sums)}


def outliers(agreements: dict[str, float]) -> list[str]:
    """Observers whose agreement is lower than the first quartile by over 1.5 interquartile ranges (Tukey)."""
    if not agreements:
        return []
    low, high = np.quantile(list(agreements.values()), [0.25, 0.75])
    return [name for name, value in agreements.items() if value < low - 1.5 * (high - low)]
