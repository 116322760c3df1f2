"""Which conditions differ, and which are equivalent, by votes of the same observers on all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from compose.base.errors import UserError
from hybrid.study.observations import Ratings, required

# Effects by Cohen's d (Sawilowsky 2009, "New effect size rules of thumb"); Fov-GS names them so.
_EFFECTS = (
    (2.0, "huge"),
    (1.2, "very large"),
    (0.8, "large"),
    (0.5, "medium"),
    (0.2, "small"),
    (0.01, "very small"),
)
# Fewer give no test of normality.
_LEAST_OBSERVERS = 3
_NAMED_POWER = 0.8

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Means:
    """Mean votes (observers, conditions), of scenes in which all conditions were seen; the best one first.

    Left out are observers who lack a condition of such a scene, and scenes that lack a condition.
    """

    observers: tuple[str, ...]
    conditions: tuple[str, ...]
    values: Floats
    left_out_observers: tuple[str, ...] = ()
    left_out_scenes: tuple[str, ...] = ()


def mean_votes(ratings: Ratings) -> Means:
    """Means over each observer's votes for a condition of a scene, then over scenes.

    UserError unless there are at least two conditions in some scene, and three observers who saw all of them.
    """
    (observers, o), (scenes, s), (conditions, c) = (
        np.unique(names, return_inverse=True)
        for names in (ratings.observer, ratings.scene, ratings.condition)
    )
    if len(conditions) < 2:
        raise UserError(f"condition {str(conditions[0])!r}: is the only one; comparing needs at least two")
    sums, counts = np.zeros((2, len(observers), len(scenes), len(conditions)))
    np.add.at(sums, (o, s, c), ratings.vote)
    np.add.at(counts, (o, s, c), 1)
    whole = (counts.sum(0) > 0).all(1)
    if not whole.any():
        raise UserError(
            "votes: no scene was shown in all conditions; conditions would be confounded with scenes"
        )
    sums, counts = sums[:, whole], counts[:, whole]
    saw_all = (counts > 0).all((1, 2))
    if saw_all.sum() < _LEAST_OBSERVERS:
        found = f"{int(saw_all.sum())} of {len(observers)} observers"
        raise UserError(
            f"votes: {found} voted on all conditions; comparing needs at least {_LEAST_OBSERVERS}"
        )
    values = (sums[saw_all] / counts[saw_all]).mean(1)
    order = np.argsort(-values.mean(0), kind="stable")
    texts = (observers[saw_all], conditions[order], observers[~saw_all], scenes[~whole])
    kept, names, lacking, incomplete = (tuple(text.tolist()) for text in texts)
    return Means(kept, names, values[:, order], lacking, incomplete)


def compare(means: Means, level: float = 0.95, margin: float = 0.25) -> dict[str, Any]:
    """Compares all pairs of conditions within observers, as Fov-GS did (Fan et al., section 5).

    If the differences of all pairs pass Shapiro-Wilk's test, conditions are compared by a repeated-measures
    ANOVA with Greenhouse and Geisser's correction, and pairs by paired t-tests, else by Friedman's and
    Wilcoxon's signed-rank tests. The p-values of pairs are adjusted by Holm's method. Pairs are equivalent
    within a margin if two one-sided tests say so (Schuirmann 1987), by the same kind of test, adjusted
    likewise. That no difference was found does not mean that there is none.

    Args:
        means: of the observers.
        level: of the intervals; 1 - level is what p-values are held against.
        margin: greatest difference, in steps of the scale, that counts as none.

    Returns:
        `observers` and `left_out_observers`, `left_out_scenes`: names; `normal`: bool; `omnibus`: see
        `omnibus`; `pairs`: rows of `first`, `second`, `difference`, `low`, `high` (Student's t),
        `normality_p`, `test`, `statistic`, `p`, `p_holm`, `d_z` (of the paired differences: mean over
        standard deviation), `d` (mean difference over sqrt of the mean of both variances), `effect` (d's size
        in words), `power` (achieved, of a paired t-test with this d_z), `detectable` (difference found with a
        power of 80 %), `equivalence_p`, `equivalence_p_holm`, `different` and `equivalent`. What has no
        value, as of differences all alike, is None.
    """
    alpha = 1 - level
    pairs = list(combinations(range(len(means.conditions)), 2))
    normality = [_normality(means.values[:, i] - means.values[:, j]) for i, j in pairs]
    normal = all(p is not None and p > alpha for p in normality)
    rows = [_pair(means, pair, normal, level, margin) for pair in pairs]
    for row, p in zip(rows, normality, strict=True):
        row["normality_p"] = p
    for name, verdict in (("p", "different"), ("equivalence_p", "equivalent")):
        for row, adjusted in zip(rows, holm([row[name] for row in rows]), strict=True):
            row[f"{name}_holm"] = adjusted
            row[verdict] = adjusted < alpha
    return {
        "observers": list(means.observers),
        "left_out_observers": list(means.left_out_observers),
        "left_out_scenes": list(means.left_out_scenes),
        "normal": normal,
        "omnibus": omnibus(means.values, normal),
        "pairs": rows,
    }


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values adjusted for their number by Holm's method."""
    # statsmodels' function collects garbage each time, which takes longer than all of a comparison.
    order = np.argsort(p_values)
    steps = np.arange(len(order), 0, -1) * np.asarray(p_values)[order]
    adjusted = np.empty(len(order))
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1)
    return adjusted.tolist()


def omnibus(values: Floats, normal: bool) -> dict[str, Any] | None:
    """Whether any of three or more conditions differ, by their values (observers, conditions); None for two.

    Returns `test`, `statistic`, `p`, and, of the ANOVA, `df` and `df_error` before correction, and `epsilon`.
    """
    people, conditions = values.shape
    if conditions < 3:
        return None
    if not normal:
        with np.errstate(invalid="ignore"):
            found = stats.friedmanchisquare(*values.T)
        return {"test": "Friedman", "statistic": float(found.statistic), "p": _one_if_undefined(found.pvalue)}
    anova = required("statsmodels.stats.anova", "the analysis of variance")
    frame = required("pandas", "the analysis of variance").DataFrame(
        {
            "vote": values.ravel(),
            "observer": np.repeat(np.arange(people), conditions),
            "condition": np.tile(np.arange(conditions), people),
        }
    )
    table = anova.AnovaRM(frame, "vote", "observer", within=["condition"]).fit().anova_table
    f, df, df_error = (float(table[name].iloc[0]) for name in ("F Value", "Num DF", "Den DF"))
    epsilon = greenhouse_geisser(values)
    p = float(stats.f.sf(f, epsilon * df, epsilon * df_error))
    test = "repeated-measures ANOVA"
    return {"test": test, "statistic": f, "p": p, "df": df, "df_error": df_error, "epsilon": epsilon}


def greenhouse_geisser(values: Floats) -> float:
    """Epsilon of the values (observers, conditions), from 1 / (conditions - 1) to 1 where they are spherical.

    Greenhouse and Geisser 1959, "On methods in the analysis of profile data": of the doubly centred
    covariance S, trace(S)^2 / ((conditions - 1) trace(S S)). statsmodels' AnovaRM does not have it.
    """
    size = values.shape[1]
    centring = np.eye(size) - 1 / size
    covariance = centring @ np.cov(values.T) @ centring
    return float(np.trace(covariance) ** 2 / ((size - 1) * (covariance**2).sum()))


def _normality(differences: Floats) -> float | None:
    """P-value of Shapiro and Wilk's test; None where all are alike."""
    return float(stats.shapiro(differences).pvalue) if np.ptp(differences) > 0 else None


def _pair(means: Means, pair: tuple[int, int], normal: bool, level: float, margin: float) -> dict[str, Any]:
    x, y = means.values[:, pair[0]], means.values[:, pair[1]]
    difference = x - y
    mean, sd, count = float(difference.mean()), float(difference.std(ddof=1)), len(difference)
    half = float(stats.t.ppf(0.5 + level / 2, count - 1)) * sd / np.sqrt(count)
    found = stats.ttest_rel(x, y) if normal else _wilcoxon(difference, "two-sided")
    pooled = float(np.sqrt((x.var(ddof=1) + y.var(ddof=1)) / 2))
    d = mean / pooled if pooled else None
    d_z = mean / sd if sd else None
    power, detectable = _power(d_z, sd, count, 1 - level)
    return {
        "first": means.conditions[pair[0]],
        "second": means.conditions[pair[1]],
        "difference": mean,
        "low": mean - half,
        "high": mean + half,
        "test": "paired t" if normal else "Wilcoxon signed-rank",
        "statistic": float(found.statistic),
        "p": _one_if_undefined(found.pvalue),
        "d_z": d_z,
        "d": d,
        "effect": effect_name(d),
        "power": power,
        "detectable": detectable,
        "equivalence_p": _equivalence(x, y, normal, margin),
    }


def effect_name(d: float | None) -> str:
    """Size of an effect in words, by the absolute value of Cohen's d."""
    size = 0.0 if d is None else abs(d)
    return next((name for least, name in _EFFECTS if size > least), "none")


def _equivalence(x: Floats, y: Floats, normal: bool, margin: float) -> float:
    """P-value of the two one-sided tests that the difference lies within the margin."""
    if normal:
        tests = required("statsmodels.stats.weightstats", "the test of equivalence")
        return float(tests.ttost_paired(x, y, -margin, margin)[0])
    difference = x - y
    above = _wilcoxon(difference + margin, "greater").pvalue
    below = _wilcoxon(difference - margin, "less").pvalue
    return max(_one_if_undefined(above), _one_if_undefined(below))


def _wilcoxon(difference: Floats, alternative: str) -> Any:
    # Means of whole votes that are equal in truth may differ in their last digits.
    with np.errstate(invalid="ignore"):
        return stats.wilcoxon(np.round(difference, 9), alternative=alternative)


def _power(d_z: float | None, sd: float, count: int, alpha: float) -> tuple[float | None, float | None]:
    """Achieved power, and the difference that would be found with a power of 80 %."""
    if d_z is None:
        return None, None
    test = required("statsmodels.stats.power", "power").TTestPower()
    detectable = test.solve_power(None, count, alpha, _NAMED_POWER)
    return float(test.power(d_z, count, alpha)), float(np.ravel(detectable)[0]) * sd


def _one_if_undefined(p: float) -> float:
    """A p-value; 1 where all values are alike, so that tests have none."""
    return 1.0 if np.isnan(p) else float(p)
