"""The results of an evaluation, as evaluation.json has them: names, values, and verdicts in words."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hybrid.measure.frame_quality import METRICS

# The method whose rays and time the baselines get.
OURS = "hybrid, fused"
# The name under which the quality of a reference itself is reported: half of its samples against the other.
HALVES = "reference, half against half"
# Costs count as equal within this share.
TOLERANCE = 0.03
# In what a method was made equal to OURS; FIXED for in nothing.
EQUAL_RAYS, EQUAL_TIME, FIXED = "equal-rays", "equal-time", "fixed"


class Key(NamedTuple):
    """What identifies a method's results: its name and its budget, EQUAL_RAYS, EQUAL_TIME or FIXED."""

    method: str
    budget: str

    @staticmethod
    def of(row: dict[str, Any]) -> Key:
        """The key of a row of results."""
        return Key(row["method"], row["budget"])

    @property
    def label(self) -> str:
        """The method as it is named in lists."""
        return self.method if self.budget == FIXED else f"{self.method} ({self.budget})"


OURS_KEY, HALVES_KEY = Key(OURS, FIXED), Key(HALVES, FIXED)


def half_name(metric: str, number: int) -> str:
    """Name of a metric against the first or the second half of a reference's samples."""
    return f"{metric}, half {number}"


def image_name(view: int, key: Key | None) -> str:
    """File name of the frame of a method and budget in a view; of the reference if None."""
    name = "reference" if key is None else "-".join(key)
    return f"{view}-{name}.png".replace(",", "").replace(" ", "-")


def flip_name(view: int, key: Key) -> str:
    """File name of a frame's FLIP map."""
    return image_name(view, key).replace(".png", "-flip.png")


# The metric that whole frames are compared by.
WHOLE_METRIC = "ssim"
# Metrics that the fovea is compared by, and those used if neither is installed.
_FOVEAL, _FALLBACK = ("jod", "flip"), ("ssim", "psnr")
METRIC_NAMES = {"jod": "FovVideoVDP", "flip": "FLIP", "ssim": "SSIM", "psnr": "PSNR", "lpips": "LPIPS"}


def is_better(metric: str, ours: float, theirs: float) -> bool:
    """Whether the first of two values is the better one."""
    return ours > theirs if METRICS[metric] else ours < theirs


class Results:
    """The content of evaluation.json (`found`), with its values by method and budget, region, and metric.

    Attributes:
        keys: methods and budgets, in the order in which they were measured.
        times: median milliseconds of the methods and budgets that were timed.
    """

    def __init__(self, found: dict[str, Any]):
        self.found = found
        self.keys = list(dict.fromkeys(map(Key.of, found["methods"])))
        self.times = {Key.of(row): float(row["ms"]["p50"]) for row in found["time"]}
        self._values: dict[tuple[Key, str, str], dict[int, float]] = {}
        for row in found["quality"]:
            by_view = self._values.setdefault((Key.of(row), row["region"], row["metric"]), {})
            by_view[row["view"]] = row["value"]

    @property
    def views(self) -> list[int]:
        """Numbers of the views."""
        return sorted({row["view"] for row in self.found["quality"]})

    @property
    def foveal_metrics(self) -> list[str]:
        """Metrics that the fovea is compared by: FovVideoVDP and FLIP; SSIM and PSNR if neither is known."""
        measured = {metric for _, _, metric in self._values}
        return [m for m in _FOVEAL if m in measured] or [m for m in _FALLBACK if m in measured]

    def mean(self, key: Key, region: str, metric: str) -> float | None:
        """Mean over the views; None if it was not measured."""
        values = [value for _, value in sorted(self._values.get((key, region, metric), {}).items())]
        return float(np.mean(values)) if values else None

    def fused_by_spp(self, metric: str) -> dict[int, float | None]:
        """Foveal quality of fused frames by samples per pixel."""
        fused = [row for row in self.found["methods"] if row.get("fovea") == "fused"]
        return {row["spp"]: self.mean(Key.of(row), "foveal", metric) for row in fused}

    def noise(self, key: Key, region: str, metric: str) -> float:
        """Noise of the difference between our frame and another method in one view; 0 without halves.

        Each half of a reference's samples yields a difference of its own. Half of what the two differ by is
        the standard error of their mean; the root mean square over the views is the noise.
        """
        first, second = (self._differences(key, region, half_name(metric, number)) for number in (1, 2))
        spreads = [(first[view] - second[view]) / 2 for view in first.keys() & second.keys()]
        return float(np.sqrt(np.mean(np.square(spreads)))) if spreads else 0.0

    def outcomes(self, key: Key, region: str, metric: str) -> list[bool | None]:
        """Whether our frame is better, view by view; None for differences up to twice the noise."""
        least = 2 * self.noise(key, region, metric)
        differences = self._differences(key, region, metric).values()
        return [None if abs(one) <= least else is_better(metric, one, 0.0) for one in differences]

    def _differences(self, key: Key, region: str, metric: str) -> dict[int, float]:
        """Our values minus those of another method, by view, where both were measured."""
        ours, theirs = (self._values.get((one, region, metric), {}) for one in (OURS_KEY, key))
        return {view: ours[view] - theirs[view] for view in sorted(ours.keys() & theirs.keys())}

    def is_ahead(self, key: Key, region: str, metric: str) -> bool | None:
        """Whether our frame is better on average; None if equal, or if the references' halves disagree."""
        outcomes: set[bool | None] = set()
        for name in (metric, half_name(metric, 1), half_name(metric, 2)):
            ours, theirs = (self.mean(k, region, name) for k in (OURS_KEY, key))
            if ours is not None and theirs is not None:
                outcomes.add(None if ours == theirs else is_better(metric, ours, theirs))
        return outcomes.pop() if len(outcomes) == 1 else None

    def time_over_ours(self, key: Key) -> float | None:
        """Median time of a method over ours; None if either was not timed."""
        for row in self.found["time"]:
            if Key.of(row) == key and "over_ours" in row:
                return float(row["over_ours"])
        times = self.times
        return times[key] / times[OURS_KEY] if key in times and OURS_KEY in times else None

    def missed_time(self, key: Key) -> str:
        """How far a baseline is from equal time, such as "20 % slower"; empty if it is within TOLERANCE."""
        ratio = self.time_over_ours(key) if key.budget == EQUAL_TIME else None
        if ratio is None or abs(ratio - 1) <= TOLERANCE + 1e-9:  # 1.03 - 1 is a little more than 0.03
            return ""
        return f"{100 * abs(ratio - 1):.0f} % {'slower' if ratio > 1 else 'faster'}"

    def budget_label(self, key: Key) -> str:
        """The budget as tables show it: equal time is not called equal where it was missed."""
        missed = self.missed_time(key)
        return f"{key.budget}, missed: {missed}" if missed else key.budget

    def label(self, key: Key) -> str:
        """A method as it is named in lists, with the budget that it met."""
        return f"{key.method} ({self.budget_label(key)})" if self.missed_time(key) else key.label

    def affordable_baselines(self) -> list[Key]:
        """Baselines that cost no more than our frame: at equal time, or without any rays and no slower."""
        rays = {Key.of(row): row["rays"] for row in self.found["methods"]}
        most = self.times.get(OURS_KEY, np.inf) * (1 + TOLERANCE)
        return [
            key
            for key in self.keys
            if key.budget == EQUAL_TIME or (rays[key] == 0 and self.times.get(key, 0.0) <= most)
        ]


# By whether our frame is ahead; bad news first.
_SENTENCES = {
    False: "{} is not ahead of {}.",
    None: "{} cannot be distinguished from {}: the difference is within the noise of the references.",
    True: "{} is ahead of {}.",
}


def verdicts(found: dict[str, Any]) -> list[str]:
    """Sentences for the top of the report; those about baselines that are better come first."""
    results = Results(found)
    metrics = results.foveal_metrics
    compared = [_compared(results, "foveal", metric) for metric in metrics]
    compared.append(_compared(results, "whole", WHOLE_METRIC))
    by_outcome = [
        sentence.format(start, _listed(names[outcome]))
        for outcome, sentence in _SENTENCES.items()
        for start, names in compared
        if names[outcome]
    ]
    return [*by_outcome, *_against_rmfr(results), *_against_splats(results, metrics)]


def _compared(results: Results, region: str, metric: str) -> tuple[str, dict[bool | None, list[str]]]:
    """The beginning of each sentence, and texts on affordable baselines by whether our frame is ahead."""
    by_outcome: dict[bool | None, list[str]] = {True: [], False: [], None: []}
    where = "In the fovea" if region == "foveal" else "Over the whole frame"
    ours = results.mean(OURS_KEY, region, metric)
    if ours is None:
        return where, by_outcome
    for key in results.affordable_baselines():
        theirs = results.mean(key, region, metric)
        if theirs is not None:
            # A mean alone says little if it is due to a few views.
            wins = _counted(results.outcomes(key, region, metric))
            missed = results.missed_time(key)
            marked = f"; {missed} than the hybrid frame" if missed else ""
            names = by_outcome[results.is_ahead(key, region, metric)]
            names.append(f"{key.method} ({theirs:.4g}; better {wins}{marked})")
    return f"{where}, by {METRIC_NAMES[metric]}, the hybrid frame ({ours:.4g})", by_outcome


def _counted(outcomes: list[bool | None]) -> str:
    ties = outcomes.count(None)
    open_ = f", too close to tell in {ties}" if ties else ""
    return f"in {outcomes.count(True)} of {len(outcomes)} views{open_}"


def _against_rmfr(results: Results) -> list[str]:
    """How many views have the higher SSIM, which is how Foveated Path Culling (FPC) counts."""
    rmfr = Key("rmfr, tuned", EQUAL_TIME)
    outcomes = results.outcomes(rmfr, "whole", WHOLE_METRIC)
    if not outcomes:
        return []
    missed = results.missed_time(rmfr)
    budget = f"tuned and {missed} than the hybrid frame" if missed else "tuned and at equal time"
    return [
        "SSIM of the whole frame is higher than that of rectangular mapping-based foveated rendering (RMFR), "
        f"{budget}, {_counted(outcomes)} (Foveated Path Culling: 2 of 5, untuned)."
    ]


def _against_splats(results: Results, metrics: list[str]) -> list[str]:
    """From how many samples on the fused fovea surpasses the splats under it."""
    sentences = []
    for metric in metrics:
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
            when = f"at none of {_listed([str(spp) for spp in sorted(by_spp)])} samples per pixel"
        sentences.append(f"By {METRIC_NAMES[metric]}, the fused fovea is better than splats alone {when}.")
    return sentences


def _listed(names: list[str]) -> str:
    return "".join(names) if len(names) < 2 else ", ".join(names[:-1]) + " and " + names[-1]
