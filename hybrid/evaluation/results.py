"""The results of an evaluation, as evaluation.json has them: names, values and times."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from hybrid.measure.frame_quality import METRICS

# The method whose rays and time the baselines get.
OURS = "hybrid, fused"
# Costs count as equal within this share, after the fact.
TOLERANCE = 0.05
# In what a method was made equal to OURS; FIXED for in nothing.
EQUAL_RAYS, EQUAL_TIME, FIXED = "equal-rays", "equal-time", "fixed"
# Kinds of views: between those of a training; from beyond the region that was prepared; wider than any view
# that was trained on.
NEAR, BEYOND, WIDE = "near", "beyond", "wide"


class Key(NamedTuple):
    """What identifies a method's results: its name and its budget, EQUAL_RAYS, EQUAL_TIME or FIXED."""

    method: str
    budget: str

    @staticmethod
    def of(row: Mapping[str, Any]) -> Key:
        """The key of a row of results."""
        return Key(row["method"], row["budget"])

    @property
    def label(self) -> str:
        """The method as it is named in lists."""
        return self.method if self.budget == FIXED else f"{self.method} ({self.budget})"


OURS_KEY = Key(OURS, FIXED)


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

    Means are over views near the scene's own, unless another kind is asked for, and over all seeds.

    Attributes:
        keys: methods and budgets, in the order in which they were measured.
        times: median milliseconds of the methods and budgets that were timed.
        kinds: of the views.
    """

    def __init__(self, found: Mapping[str, Any]):
        self.found = found
        self.keys = list(dict.fromkeys(map(Key.of, found["methods"])))
        self.times = {Key.of(row): float(row["ms"]["p50"]) for row in found["time"]}
        self._views = {row["view"]: row["kind"] for row in found["views"]}
        self.kinds = list(dict.fromkeys(self._views.values()))
        by_seed: dict[tuple[Key, str, str], dict[int, list[float]]] = {}
        for row in found["quality"]:
            by_view = by_seed.setdefault((Key.of(row), row["region"], row["metric"]), {})
            # JSON has no infinity: the PSNR of equal images.
            by_view.setdefault(row["view"], []).append(np.inf if row["value"] is None else row["value"])
        self._values = {
            name: {view: float(np.mean(values)) for view, values in sorted(by_view.items())}
            for name, by_view in by_seed.items()
        }

    def views_of(self, kind: str) -> list[int]:
        """Numbers of the views of a kind."""
        return [view for view, its_kind in self._views.items() if its_kind == kind]

    @property
    def foveal_metrics(self) -> list[str]:
        """Metrics that the fovea is compared by: FovVideoVDP and FLIP; SSIM and PSNR if neither is known."""
        measured = {metric for _, _, metric in self._values}
        return [m for m in _FOVEAL if m in measured] or [m for m in _FALLBACK if m in measured]

    def by_view(self, key: Key, region: str, metric: str, kind: str = NEAR) -> dict[int, float]:
        """A metric by the number of the view; empty if it was not measured."""
        values = self._values.get((key, region, metric), {})
        return {view: value for view, value in values.items() if self._views[view] == kind}

    def mean(self, key: Key, region: str, metric: str, kind: str = NEAR) -> float | None:
        """Mean over the views; None if it was not measured."""
        values = self.by_view(key, region, metric, kind)
        return float(np.mean(list(values.values()))) if values else None

    def differences(self, key: Key, region: str, metric: str, kind: str = NEAR) -> list[float]:
        """Our values minus those of another method, of views in which both were measured; 0 if equal."""
        ours, theirs = (self.by_view(one, region, metric, kind) for one in (OURS_KEY, key))
        both = ((ours[view], theirs[view]) for view in ours if view in theirs)
        return [0.0 if mine == other else mine - other for mine, other in both]

    def squared_error(self, key: Key, region: str, kind: str) -> float | None:
        """Mean squared error in sRGB of a method's frames, over the views; None if it was not measured."""
        return _mean_error(self.by_view(key, region, "psnr", kind).values())

    def reference_error(self, region: str, kind: str) -> float | None:
        """The same of the references, against the truth."""
        rows = self.found["references"]
        return _mean_error(
            row["psnr"] for row in rows if row["region"] == region and self._views[row["view"]] == kind
        )

    def fused_by_spp(self, metric: str) -> dict[int, float | None]:
        """Foveal quality of fused frames by samples per pixel."""
        fused = [
            row for row in self.found["methods"] if row.get("fovea") == "fused" and row["budget"] == FIXED
        ]
        return {row["spp"]: self.mean(Key.of(row), "foveal", metric) for row in fused}

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
        if ratio is None or abs(ratio - 1) <= TOLERANCE + 1e-9:  # 1.05 - 1 is a little more than 0.05
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


def _mean_error(psnr: Iterable[float | None]) -> float | None:
    """Mean squared error of values from 0 to 1, of PSNR in dB; None for infinite."""
    errors = [0.0 if one is None else 10 ** (-one / 10) for one in psnr]
    return float(np.mean(errors)) if errors else None
