"""From observations to what they say: qualities, differences, equivalence, and sentences about them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy import stats

from compose.base.errors import UserError
from hybrid.study.comparisons import compare, holm, mean_votes
from hybrid.study.observations import Choices, Ratings, without
from hybrid.study.ratings import opinion_scores, screening
from hybrid.study.scaling import PRIORS, Scale, agreement, outliers, pooled, scale

Row = dict[str, Any]
# All pairs of so many conditions are told in sentences; of more, those with the reference or the best one.
_MOST_TOLD = 5


@dataclass(frozen=True)
class AnalysisSettings:
    """What an analysis is held against.

    Args:
        level: of intervals; 1 - level is what p-values are held against.
        margin: greatest difference, in JOD or steps of the scale, that counts as none.
        reference: condition whose quality in JOD is `anchor`; None: the mean of the conditions has it.
        anchor: JOD.
        prior: of qualities, see `scaling.scale`.
        screen: whether observers are left out, by BT.500, or for choices that disagree with all others'.

    UserError for a value out of range.
    """

    level: float = 0.95
    margin: float = 0.25
    reference: str | None = None
    anchor: float = 0.0
    prior: str = "jeffreys"
    screen: bool = False

    def __post_init__(self) -> None:
        if not 0.5 <= self.level < 1:
            raise UserError(f"level {self.level:g}: must be from .5 to below 1")
        if not (self.margin > 0 and math.isfinite(self.margin)):
            raise UserError(f"margin {self.margin:g}: must be a positive number")
        if not math.isfinite(self.anchor):
            raise UserError(f"anchor {self.anchor:g}: must be a number")
        if self.prior not in PRIORS:
            raise UserError(f"prior {self.prior!r}: must be {' or '.join(PRIORS)}")


def analyse(observations: Ratings | Choices, settings: AnalysisSettings | None = None) -> dict[str, Any]:
    """Analyses votes or choices; what is returned can be written as JSON.

    Returns:
        `kind`: "ratings" or "choices"; `settings`; `observers`, `answers`, `left_out`: numbers of all
        observers, of their answers, and of rows that were no answers; `dropped`: names of observers left out
        (in `screening`, those that the rule finds, left out or not); `sentences`: what was found,
        in words; and

        of ratings: `screening` (see `ratings.screening`), `scores` (see `ratings.opinion_scores`), `votes`
        (rows of `condition` and `counts`, by vote as a text), `comparison` (see `comparisons.compare`; None
        where nothing can be compared, for which `not_compared` is the reason, otherwise "");

        of choices: `screening` (rows of `observer`, `answers`, `agreement`, see `scaling.agreement`, and
        `dropped`), and `scales`: the mean of all groups first, if they have the same conditions, then each
        group. A scale has `group` ("" for the mean or a single one), `observers`, `qualities` (rows of
        `condition`, `jod`, `low`, `high`, best first), and `pairs` (rows of `first`, `second`, `difference`,
        `low`, `high`, `p`, `p_holm`, `trials`, `first_chosen`, `share`, `binomial_p`, `binomial_p_holm`,
        `equivalence_p`, `equivalence_p_holm`, `different`, `equivalent`; the better one first). The binomial
        test is of two sides, and takes trials for independent, which those of one observer are not: `p` does
        not, and decides.

    UserError for observations that cannot be analysed, see `scaling.scale`.
    """
    settings = settings or AnalysisSettings()
    found: Row = {
        "kind": "ratings" if isinstance(observations, Ratings) else "choices",
        "settings": asdict(settings),
        "observers": len(np.unique(observations.observer)),
        "answers": len(observations.observer),
        "left_out": observations.left_out,
    }
    if isinstance(observations, Ratings):
        found |= _of_ratings(observations, settings)
    else:
        found |= _of_choices(observations, settings)
    found["sentences"] = [*_about_observers(found), *_about_quality(found)]
    return found


def _of_ratings(ratings: Ratings, settings: AnalysisSettings) -> Row:
    if settings.reference not in (None, *ratings.condition):
        known = ", ".join(np.unique(ratings.condition)[:5])
        raise UserError(f"votes: no reference {settings.reference!r}; their conditions are: {known}")
    rows = screening(ratings)
    dropped = [row["observer"] for row in rows if row["dropped"]] if settings.screen else []
    kept = without(ratings, dropped)
    if not len(kept.vote):
        raise UserError("votes: every observer was screened out")
    comparison, reason = None, ""
    try:
        comparison = compare(mean_votes(kept), settings.level, settings.margin)
    except UserError as error:
        reason = str(error)
    votes = []
    for condition in np.unique(kept.condition):
        values, counts = np.unique(kept.vote[kept.condition == condition], return_counts=True)
        texts = {f"{value:g}": int(count) for value, count in zip(values, counts, strict=True)}
        votes.append({"condition": str(condition), "counts": texts})
    return {
        "dropped": dropped,
        "screening": rows,
        "scores": opinion_scores(kept, settings.level),
        "votes": votes,
        "comparison": comparison,
        "not_compared": reason,
    }


def _of_choices(choices: Choices, settings: AnalysisSettings) -> Row:
    wanted = settings.reference, settings.anchor, settings.prior
    scales = scale(choices, *wanted)
    agreements = agreement(choices, scales)
    suspects = outliers(agreements)
    dropped = suspects if settings.screen else []
    rows = [
        {
            "observer": name,
            "answers": int((choices.observer == name).sum()),
            "agreement": value,
            "dropped": name in suspects,
        }
        for name, value in agreements.items()
    ]
    if dropped:
        choices = without(choices, dropped)
        scales = scale(choices, *wanted)
    mean = pooled(scales)
    told = [_told(found, choices, settings) for found in ([mean] if mean else []) + scales]
    return {"dropped": dropped, "screening": rows, "scales": told}


def _told(found: Scale, choices: Choices, settings: AnalysisSettings) -> Row:
    low, high = found.interval(settings.level)
    order = np.argsort(-found.jod, kind="stable")
    names = found.conditions
    qualities = [
        {"condition": names[n], "jod": float(found.jod[n]), "low": float(low[n]), "high": float(high[n])}
        for n in order
    ]
    # How often one condition was chosen over another.
    here = choices.group == found.group if found.group else slice(None)
    first, second, won = choices.first[here], choices.second[here], choices.chosen_first[here]
    winners, losers = np.where(won, first, second), np.where(won, second, first)
    chosen = Counter(zip(winners.tolist(), losers.tolist(), strict=True))
    pairs = [_pair(found, (int(a), int(b)), chosen, settings) for a, b in combinations(order, 2)]
    for name in ("p", "equivalence_p", "binomial_p"):
        known = [row for row in pairs if row[name] is not None]
        for row, adjusted in zip(known, holm([row[name] for row in known]), strict=True):
            row[f"{name}_holm"] = adjusted
    for row in pairs:
        row["different"] = row["p_holm"] < 1 - settings.level
        row["equivalent"] = row["equivalence_p_holm"] < 1 - settings.level
    return {"group": found.group, "observers": len(found.observers), "qualities": qualities, "pairs": pairs}


def _pair(
    found: Scale, pair: tuple[int, int], chosen: Counter[tuple[str, str]], settings: AnalysisSettings
) -> Row:
    difference = found.difference(*pair, settings.level, settings.margin)._asdict()
    first, second = (found.conditions[n] for n in pair)
    wins = chosen[first, second]
    trials = wins + chosen[second, first]
    return {
        "first": first,
        "second": second,
        "difference": difference.pop("jod"),
        **difference,
        "trials": trials,
        "first_chosen": wins,
        "share": wins / trials if trials else None,
        "binomial_p": float(stats.binomtest(wins, trials).pvalue) if trials else None,
        "binomial_p_holm": None,
    }


def _about_observers(found: Row) -> Iterator[str]:
    rated = found["kind"] == "ratings"
    rule = "by the screening of BT.500" if rated else "because their choices disagree with all others'"
    said = f"{found['observers']} observers gave {found['answers']:,} {'votes' if rated else 'choices'}"
    if found["left_out"]:
        said += f"; {found['left_out']:,} rows without an answer, or of training, were left out"
    yield f"{said}."
    suspects = ", ".join(row["observer"] for row in found["screening"] if row["dropped"])
    if suspects:
        yield f"{'Left out' if found['dropped'] else 'Suspected, but kept,'} {rule}: {suspects}."
    comparison = found.get("comparison")
    if comparison and comparison["left_out_observers"]:
        names = ", ".join(comparison["left_out_observers"])
        yield f"Not compared, for lack of votes on some condition: {names}."
    if comparison and comparison["left_out_scenes"]:
        yield f"Not compared, for lack of some condition: {', '.join(comparison['left_out_scenes'])}."


def _about_quality(found: Row) -> Iterator[str]:
    settings = found["settings"]
    percent, margin, reference = f"{100 * settings['level']:g} %", settings["margin"], settings["reference"]
    if found["kind"] == "choices":
        scales = found["scales"]
        if len(scales) > 1 and scales[0]["group"]:
            for told in scales:
                differ = sum(row["different"] for row in told["pairs"])
                best, *_, worst = (f"{row['condition']} ({row['jod']:.2f} JOD)" for row in told["qualities"])
                count = f"{differ} of {len(told['pairs'])} pairs differ"
                yield f"{told['group']}: from {worst} to {best}; {count}."
            return
        pairs, better, unit = scales[0]["pairs"], "is preferred over", "JOD"
    else:
        score = found["scores"][0]
        interval = "" if score["low"] is None else f", {percent} interval {_span(score)} over observers"
        yield f"The mean opinion score of all votes is {score['mean']:.2f}{interval}."
        if found["comparison"] is None:
            yield f"Conditions were not compared: {found['not_compared']}."
            return
        pairs, better, unit = found["comparison"]["pairs"], "is rated higher than", "steps"
    if len(pairs) > _MOST_TOLD * (_MOST_TOLD - 1) // 2:
        one = reference or pairs[0]["first"]
        pairs = [row for row in pairs if one in (row["first"], row["second"])]
    for row in pairs:
        yield sentence(row, better, unit, percent, margin)


def sentence(row: Row, better: str, unit: str, percent: str, margin: float) -> str:
    """What a pair's row says, the better condition first; never that there is no difference."""
    interval = f"{percent} interval {_span(row)}"
    within = f"equivalent within {margin:g} {unit}"
    if row["different"]:
        effect = f", a {row['effect']} effect" if row.get("effect") else ""
        but = f", but {within}" if row["equivalent"] else ""
        size = f"{row['difference']:.2f} {unit}, {interval}, {p_text(row['p_holm'])}{effect}"
        return f"{row['first']} {better} {row['second']}: {size}{but}."
    between = f"No difference found between {row['first']} and {row['second']}"
    if row["equivalent"]:
        return f"{between}, and {within} ({interval})."
    most = max(abs(row["low"]), abs(row["high"]))
    return f"{between}, but one of up to {most:.2f} {unit} is not ruled out ({interval})."


def p_text(p: float) -> str:
    """A p-value as it is written in a text."""
    return "p < .001" if p < 0.001 else f"p = {p:.3f}".replace("0.", ".")


def _span(row: Row) -> str:
    return f"{row['low']:.2f} to {row['high']:.2f}"
