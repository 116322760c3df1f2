"""Which of two methods is ahead, with intervals over views, as rows and in words.

Differences are paired: our frame's value of a metric minus another method's, of the same view, each the mean
over all seeds. Views are what the result is to hold for beyond those that were measured, so that they are
what is resampled.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid.evaluation.results import EQUAL_TIME, FIXED, METRIC_NAMES, NEAR, OURS_KEY, Key, Results, is_better
from hybrid.measure.frame_quality import METRICS

Array = NDArray[np.float64]
# Means of a metric that differ by less than this are equal to a viewer: a tenth of a just-objectionable
# difference, and what is lost in rounding of the tables of others.
MARGINS = {"psnr": 0.25, "ssim": 0.005, "flip": 0.005, "jod": 0.1}
# What a verdict says of our frame; undecided: the views or their references do not suffice to tell.
AHEAD, EQUAL, BEHIND, UNDECIDED = "ahead", "equal", "behind", "undecided"
# Decibels by which references must be closer to the truth than the better of two methods is to them.
LEAD = 6.0
# Probabilities that an interval holds the mean: of a difference, and of each of two one-sided tests at 5 %.
_DIFFERENCE, _EQUIVALENCE = 0.95, 0.90
# Fewer views have too few different resamplings.
_LEAST_RESAMPLED, _RESAMPLINGS = 8, 4000
# Regions in which methods are compared; the last one by frames of the first seed only.
COMPARED = ("whole", "foveal", "peripheral")


class Interval(NamedTuple):
    """A mean over views and the confidence interval around it, which is infinite for a single view."""

    mean: float
    low: float
    high: float


def mean_interval(values: Sequence[float], level: float) -> Interval:
    """The mean of finite values, one or more, with its confidence interval of a level in 0..1.

    By the studentized bootstrap (Efron and Tibshirani 1993, 12.5), whose 95 % intervals hold the mean in 92
    to 96 % of cases for 5 to 40 values of normal, exponential and Student's t(3) distributions, where those
    of the accelerated bootstrap do in 86 to 94 %; by Student's t for fewer than 8 values, or if almost all
    are the same.
    """
    return _interval(tuple(values), level)


# Rows, the sentences of the command and those of the page ask for the same intervals.
@lru_cache(4096)
def _interval(values: tuple[float, ...], level: float) -> Interval:
    from scipy.stats import t as student

    data = np.asarray(values, dtype=np.float64)
    count, mean = len(data), float(data.mean())
    if count < 2:
        return Interval(mean, -np.inf, np.inf)
    error, tail = float(data.std(ddof=1) / np.sqrt(count)), (1 - level) / 2
    picked = data[np.random.default_rng(0).integers(count, size=(_RESAMPLINGS, count))]
    # A resampling of equal values has no t; its deviation is not zero but that of rounding.
    picked = picked[np.ptp(picked, axis=1) > 0]
    if count < _LEAST_RESAMPLED or len(picked) < (1 - tail) * _RESAMPLINGS:
        reach = float(student.ppf(1 - tail, count - 1)) * error
        return Interval(mean, mean - reach, mean + reach)
    errors = picked.std(axis=1, ddof=1) / np.sqrt(count)
    low, high = np.quantile((picked.mean(axis=1) - mean) / errors, (tail, 1 - tail))
    return Interval(mean, mean - float(high) * error, mean - float(low) * error)


def verdict(differences: Sequence[float], metric: str) -> tuple[Interval, str]:
    """The mean of our values minus another method's, with its 95 % interval, and what that says of ours.

    EQUAL by two one-sided tests (Schuirmann 1987): the 90 % interval lies within the metric's margin. AHEAD
    or BEHIND if the 95 % interval holds no zero, otherwise UNDECIDED.
    """
    found = mean_interval(differences, _DIFFERENCE)
    _, low, high = mean_interval(differences, _EQUIVALENCE)
    if max(abs(low), abs(high)) < MARGINS[metric]:
        return found, EQUAL
    if found.low <= 0 <= found.high:
        return found, UNDECIDED
    return found, AHEAD if is_better(metric, found.mean, 0.0) else BEHIND


def verdict_rows(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of scene, display, views, region, metric, baseline, budget, difference, low, high, lead, verdict.

    There is one for each kind of views, region, metric of MARGINS and method but ours, as far as they were
    measured; of the content of evaluation.json. The lead is that of the region's references, in dB: whatever
    the views say, a pair is UNDECIDED below LEAD.
    """
    results = Results(found)
    rows = []
    for kind, region, metric, key, differences in _measured(results):
        interval, says = verdict(differences, metric)
        lead = _lead(results, key, region, kind)
        if lead < LEAD:
            says = UNDECIDED
        rows.append(
            {
                "scene": found["scene"],
                "display": display_name(found),
                "views": kind,
                "region": region,
                "metric": metric,
                "baseline": key.method,
                "budget": key.budget,
                "difference": interval.mean,
                "low": interval.low,
                "high": interval.high,
                "lead": lead,
                "verdict": says,
            }
        )
    return rows


def _measured(results: Results) -> Iterator[tuple[str, str, str, Key, list[float]]]:
    """Kinds of views, regions, metrics and methods, with their differences where all of these are numbers."""
    for kind in results.kinds:
        for region in COMPARED:
            for metric in (one for one in METRICS if one in MARGINS):
                for key in (one for one in results.keys if one != OURS_KEY):
                    differences = results.differences(key, region, metric, kind)
                    if differences and np.isfinite(differences).all():
                        yield kind, region, metric, key, differences


def _lead(results: Results, key: Key, region: str, kind: str) -> float:
    """Decibels by which references lead the better of our frame and another method, in mean squared error."""
    truth = results.reference_error(region, kind)
    errors = [results.squared_error(one, region, kind) for one in (OURS_KEY, key)]
    known = [error for error in errors if error is not None]
    if truth is None or not known:
        return -np.inf
    return np.inf if truth == 0 else float(10 * np.log10(max(min(known), 1e-30) / truth))


def display_name(found: Mapping[str, Any]) -> str:
    """The frame's size and density, such as "512x512, 35 pixels per degree"."""
    from compose.eye.display import Display

    density = Display(**found["display"]).pixels_per_degree
    return f"{found['settings']['width']}x{found['settings']['height']}, {density:.0f} pixels per degree"


# Why nothing is decided, in sentences.
_NOT_LED = "not led"
# Bad news first.
_SENTENCES = {
    BEHIND: "{} is behind {}.",
    UNDECIDED: "{} cannot be told from {}: the views do not suffice.",
    _NOT_LED: "{} cannot be told from {}: the references are not close enough to the truth.",
    EQUAL: "{} equals {}.",
    AHEAD: "{} is ahead of {}.",
}
_DIGITS = {"psnr": 1, "ssim": 3, "flip": 3, "jod": 2}
_WHERE = {"whole": "over the whole frame", "foveal": "in the fovea"}
_KINDS = {NEAR: "", "beyond": " from beyond the prepared region", "wide": " wider than any training view"}


def sentences(found: Mapping[str, Any]) -> list[str]:
    """Sentences for the top of the report: at equal time, by kind of views, whole frame and fovea."""
    results, rows = Results(found), verdict_rows(found)
    lines = []
    for kind in results.kinds:
        metrics = [("whole", "ssim"), *(("foveal", metric) for metric in results.foveal_metrics)]
        count = len(results.views_of(kind))
        start = f"{found['scene']}, {display_name(found)}, {count} view{'s' * (count > 1)}{_KINDS[kind]}"
        for region, metric in metrics if kind == NEAR else metrics[:1]:
            same = [r for r in rows if (r["views"], r["region"], r["metric"]) == (kind, region, metric)]
            lines += _compared(results, f"{start}: {_WHERE[region]}", same)
    return [*lines, *_against_rmfr(results), *_against_splats(results)]


def _compared(results: Results, start: str, rows: list[dict[str, Any]]) -> list[str]:
    """Sentences on baselines that cost no more than our frame, then on our frame without one of its parts."""
    if not rows:
        return []
    affordable = results.affordable_baselines()
    form = f"+.{_DIGITS[rows[0]['metric']]}f"
    lines = []
    for of_parts in (False, True):
        by_verdict: dict[str, list[str]] = {says: [] for says in _SENTENCES}
        for row in rows:
            key = Key(row["baseline"], row["budget"])
            if key not in affordable or key.method.startswith("hybrid") != of_parts:
                continue
            missed = results.missed_time(key)
            texts = [f"{row['difference']:{form}}"]
            if np.isfinite([row["low"], row["high"]]).all():
                texts.append(f"{row['low']:{form}} to {row['high']:{form}}")
            texts += [f"{missed} than the hybrid frame"] if missed else []
            says = _NOT_LED if row["lead"] < LEAD else row["verdict"]
            name = key.method.replace("hybrid, ", "one ")
            by_verdict[says].append(f"{name} ({'; '.join(texts)})")
        what = f"{start}, by {METRIC_NAMES[rows[0]['metric']]}, the hybrid frame"
        lines += [
            text.format(what, listed(by_verdict[says]))
            for says, text in _SENTENCES.items()
            if by_verdict[says]
        ]
    return lines


def _against_rmfr(results: Results) -> list[str]:
    """How many views have the higher SSIM, which is how Foveated Path Culling (FPC) counts."""
    rmfr = Key("rmfr, tuned", EQUAL_TIME)
    differences = results.differences(rmfr, "whole", "ssim")
    if not differences:
        return []
    missed = results.missed_time(rmfr)
    budget = f"tuned and {missed} than the hybrid frame" if missed else "tuned and at equal time"
    return [
        "SSIM of the whole frame is higher than that of rectangular mapping-based foveated rendering (RMFR), "
        f"{budget}, in {sum(one > 0 for one in differences)} of {len(differences)} views (Foveated Path "
        "Culling: 2 of 5, untuned)."
    ]


def _against_splats(results: Results) -> list[str]:
    """From how many samples on the fused fovea surpasses the splats under it."""
    found = []
    for metric in results.foveal_metrics:
        splats = results.mean(Key("splats alone", FIXED), "foveal", metric)
        if splats is None:
            continue
        by_spp = results.fused_by_spp(metric)
        better = {spp: ours is not None and is_better(metric, ours, splats) for spp, ours in by_spp.items()}
        # A count does not qualify if a higher one is worse again.
        counts = [spp for spp in sorted(better) if all(better[more] for more in better if more >= spp)]
        if counts:
            when = f"from {counts[0]} samples per pixel on" if counts[0] > 1 else "even at 1 sample per pixel"
        else:
            tried = listed([str(spp) for spp in sorted(by_spp)])
            when = f"at none of the sample counts that were tried ({tried} per pixel)"
        found.append(f"By {METRIC_NAMES[metric]}, the fused fovea is better than splats alone {when}.")
    return found


def listed(names: list[str]) -> str:
    """Names as a sentence has them: "a, b and c"."""
    return "".join(names) if len(names) < 2 else ", ".join(names[:-1]) + " and " + names[-1]
