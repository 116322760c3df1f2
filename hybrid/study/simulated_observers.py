"""Made-up observers, to try a design and its analysis before people come; the qualities in JOD are given."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import require_seed
from hybrid.study.observations import Choices, Ratings
from hybrid.study.scaling import SIGMA, preference

# Share of the trials in which an observer presses any button; steps of a scale per JOD; standard deviations,
# in steps, of observers' biases and opinions, and from vote to vote. All are made up; with them, a single
# vote has a standard deviation of some .8, as in FPC's study (.88).
_LAPSE, _SLOPE, _SPREAD, _NOISE = 0.02, 0.6, 0.4, 0.6
# Qualities in JOD by condition, by scene.
Qualities = Mapping[str, Mapping[str, float]]


def chosen_share(jod: Any, lapse: float = _LAPSE) -> Any:
    """Probability that what is better by some JOD is chosen, with lapses."""
    return lapse / 2 + (1 - lapse) * preference(jod)


def rounded_vote(jod: Any, own: Any, slope: float = _SLOPE) -> Any:
    """The vote from 1 to 5 on a quality, with an observer's own opinion and noise in steps."""
    return np.clip(np.rint(5 - slope * (10 - jod) + own), 1, 5)


def opinions(random: np.random.Generator, count: int) -> NDArray[np.float64]:
    """(count,) an observer's own opinions of conditions, bias included, in steps."""
    return random.normal(0, _SPREAD) + random.normal(0, _SPREAD, count)


def noise(random: np.random.Generator) -> float:
    """By how much a vote is off, in steps."""
    return float(random.normal(0, _NOISE))


def simulated_choices(
    jods: Qualities,
    observers: int,
    repetitions: int = 1,
    seed: int = 0,
    lapse: float = _LAPSE,
    spread: float = 0.0,
) -> Choices:
    """Choices between all pairs of the conditions of each scene, by Thurstone's case V (1 JOD is 75 %).

    Args:
        jods: qualities in JOD, by condition, by scene.
        observers: how many.
        repetitions: trials of each pair.
        seed: of the random numbers.
        lapse: share of the trials in which an observer presses any button.
        spread: standard deviation in JOD of observers' own qualities of a condition; all observers together
            still prefer as the given qualities say.
    """
    random = np.random.default_rng(require_seed(seed))
    rows, chosen = [], []
    for scene, qualities in jods.items():
        own = _own(random, qualities, observers, spread)
        names = list(qualities)
        for first, second in combinations(range(len(names)), 2):
            prefers = chosen_share(own[:, first] - own[:, second], lapse)
            # Each is shown first as often as the other, up to one.
            swapped = (np.arange(repetitions) + random.integers(2, size=(observers, 1))) % 2 == 1
            better = random.random((observers, repetitions)) < prefers[:, None]
            order = np.where(swapped[..., None], [second, first], [first, second]).reshape(-1, 2)
            rows.append(_rows(observers, repetitions, scene, np.array(names)[order].T))
            chosen.append((better ^ swapped).ravel())
    observer, group, first_shown, second_shown = (np.concatenate(part) for part in zip(*rows, strict=True))
    return Choices(observer, group, first_shown, second_shown, np.concatenate(chosen))


def simulated_ratings(
    jods: Qualities,
    observers: int,
    repetitions: int = 1,
    seed: int = 0,
    slope: float = _SLOPE,
    spread: float = _SPREAD,
    noise: float = _NOISE,
) -> Ratings:
    """Votes from 1 to 5 for every condition of each scene; 10 JOD is what cannot be told from the reference.

    A vote is 5 - slope * (10 - JOD) + the observer's bias + noise, rounded to the nearest step, and kept on
    the scale.

    Args:
        jods: qualities in JOD, by condition, by scene.
        observers: how many.
        repetitions: votes for each condition and scene.
        seed: of the random numbers.
        slope: steps of the scale per JOD.
        spread: standard deviation of observers' biases, and of their own opinion of a condition, in steps.
        noise: standard deviation from vote to vote, in steps.
    """
    random = np.random.default_rng(require_seed(seed))
    bias = random.normal(0, spread, (observers, 1))
    conditions = dict.fromkeys(name for qualities in jods.values() for name in qualities)
    # An observer's opinion of a condition is the same in all scenes.
    own = {name: bias + random.normal(0, spread, (observers, 1)) for name in conditions}
    rows, votes = [], []
    for scene, qualities in jods.items():
        for name, jod in qualities.items():
            vote = rounded_vote(jod, own[name] + random.normal(0, noise, (observers, repetitions)), slope)
            rows.append(_rows(observers, repetitions, scene, np.full((1, observers * repetitions), name)))
            votes.append(vote.ravel())
    observer, where, condition = (np.concatenate(part) for part in zip(*rows, strict=True))
    return Ratings(observer, where, condition, np.concatenate(votes))


def _own(
    random: np.random.Generator, jods: Mapping[str, float], observers: int, spread: float
) -> NDArray[np.float64]:
    """Qualities (observers, conditions) as each observer sees them."""
    # Over observers, the difference of two qualities has the variance of both on top.
    widened = np.array(list(jods.values())) * np.sqrt(1 + 2 * (spread / SIGMA) ** 2)
    return widened + random.normal(0, spread, (observers, len(jods)))


def _rows(observers: int, repetitions: int, scene: str, names: NDArray[np.str_]) -> list[NDArray[np.str_]]:
    """Columns of an observer's name, the scene, and the given ones."""
    digits = len(str(observers))
    people = np.repeat([f"O{n:0{digits}}" for n in range(1, observers + 1)], repetitions)
    return [people, np.full(len(people), scene), *names]
