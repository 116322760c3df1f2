"""What an evaluation compares in a view: methods at budgets, the quality of their frames, their times."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compose.camera.camera import Camera, View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode
from hybrid.base.progress import Steps
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.evaluation.methods import Family, HybridMethod, Method, SplatsAlone
from hybrid.evaluation.results import (
    EQUAL_RAYS,
    EQUAL_TIME,
    FIXED,
    OURS,
    OURS_KEY,
    TOLERANCE,
    Key,
    flip_name,
    image_name,
)
from hybrid.evaluation.scoring import Rows, ScoringTask
from hybrid.evaluation.verdicts import COMPARED, MARGINS
from hybrid.measure.frame_quality import METRICS, Viewer
from hybrid.measure.frame_times import (
    jittered_view,
    path_around,
    percentiles,
    ratio_of_medians,
)
from hybrid.measure.image_metrics import ImageRegion
from hybrid.measure.reference import Reference
from hybrid.render.frame_renderer import Renderer
from hybrid.render.image_files import write_png

# Samples per pixel of further fused frames, which show from which count on they surpass the splats.
OTHER_SPP = (1, 2, 4, 16)
# Frames of a view before those that are timed.
_WARM_UP = 1
# Methods with at least this many frames of a view are not timed for longer than this.
_LEAST_REPEATS, _MOST_SECONDS = 3, 4.0
# Frames from which on a percentile is one of them instead of a guess between two.
_ENOUGH_FOR = {50: 1, 95: 20, 99: 100}
# Scores tasks in their order.
Scored = Callable[[Iterable[ScoringTask]], Iterator[Rows]]


@dataclass(frozen=True)
class Entry:
    """A method at one budget: EQUAL_RAYS, EQUAL_TIME or FIXED; `briefly` if few frames suffice to time it."""

    name: str
    budget: str
    method: Method
    briefly: bool = False

    @property
    def key(self) -> Key:
        return Key(self.name, self.budget)


def hybrid_entries(renderer: Renderer, settings: EvaluationSettings) -> list[Entry]:
    """Hybrid frames with each fovea mode, and fused ones with other sample counts."""

    def hybrid(mode: FoveaMode, spp: int) -> HybridMethod:
        return HybridMethod(renderer, replace(settings.frame, fovea=mode, spp=spp))

    other = [spp for spp in OTHER_SPP if spp != settings.frame.spp and not settings.quick]
    return [
        *(Entry(f"hybrid, {mode.value}", FIXED, hybrid(mode, settings.frame.spp)) for mode in FoveaMode),
        *(Entry(f"{OURS}, {spp} spp", FIXED, hybrid(FoveaMode.FUSED, spp), briefly=True) for spp in other),
    ]


def splat_entries(splats: SplatsAlone, flat: SplatsAlone | None) -> list[Entry]:
    """Splats alone: those of the forest, and if given a model without trees."""
    entries = [Entry("splats alone", FIXED, splats)]
    return entries if flat is None else [*entries, Entry("3dgs, no forest", FIXED, flat)]


def baseline_entries(
    known: Mapping[str, Family], met: Mapping[str, float | None], rays: float, camera: Camera, gaze: Gaze
) -> list[Entry]:
    """Path-traced baselines with the rays of our frame in a view, and with those that met its time, if any.

    One that takes more rays even at its cheapest is FIXED; one whose settings meet both budgets is included
    twice.
    """
    entries = []
    for name, family in known.items():
        equal = family(rays)
        affordable = equal.rays(camera, gaze) <= rays * (1 + TOLERANCE)
        entries.append(Entry(name, EQUAL_RAYS if affordable else FIXED, equal, briefly=True))
        at_our_time = met[name]
        if at_our_time is not None:
            entries.append(Entry(name, EQUAL_TIME, family(at_our_time)))
    return entries


def quality_rows(
    entries: Sequence[Entry], at: EvaluatedView, folder: Path, scored: Scored, progress: Steps
) -> list[dict[str, Any]]:
    """Rows of view, seed, method, budget, region, metric and value of a view.

    Frames of brief entries, and those that trace nothing, are of the first seed only; brief entries and
    further seeds have only what methods are compared by. Images and FLIP maps of the first seed are written
    for views that are shown.
    """
    if at.is_shown:
        write_png(folder / image_name(at.number, None), at.reference.radiance)
    wanted = [
        (seed, entry)
        for seed in range(at.settings.seeds)
        for entry in entries
        if seed == 0 or not (entry.briefly or entry.method.rays(at.view.camera, at.settings.frame.gaze) == 0)
    ]
    rows = []
    tasks = (at.task(entry, seed, folder) for seed, entry in wanted)
    for number, ((seed, entry), found) in enumerate(zip(wanted, scored(tasks), strict=True)):
        key = {"view": at.number, "seed": seed, "method": entry.name, "budget": entry.budget}
        rows += [{**key, **row} for row in found]
        progress(number + 1, len(wanted))
    return rows


@dataclass(frozen=True)
class EvaluatedView:
    """A view of a kind, numbered from 0, with its reference and its regions by name."""

    number: int
    kind: str
    view: View
    reference: Reference
    regions: dict[str, ImageRegion]
    settings: EvaluationSettings
    is_shown: bool

    def task(self, entry: Entry, seed: int, folder: Path) -> ScoringTask:
        """Renders an entry's frame; returns what to score."""
        viewer = Viewer(self.settings.frame.display, self.settings.frame.gaze)
        # Views and seeds have noise of their own, and all methods of a view and seed the same.
        number = self.settings.seed + self.number * self.settings.seeds + seed
        image = entry.method.render(self.view, viewer.gaze, number).image
        briefly = entry.briefly or seed > 0
        wanted = COMPARED if seed == 0 else COMPARED[:2]
        parts = {name: part for name, part in self.regions.items() if not briefly or name in wanted}
        metrics = tuple(MARGINS if briefly else METRICS)
        flip_file = None
        if self.is_shown and seed == 0:
            write_png(folder / image_name(self.number, entry.key), image)
            flip_file = folder / flip_name(self.number, entry.key)
        return ScoringTask(entry.name, image, self.reference.radiance, parts, viewer, metrics, flip_file)


def timed(entries: Sequence[Entry], at: EvaluatedView, progress: Steps) -> list[dict[str, Any]]:
    """Rows of method, budget and passes: milliseconds of each frame of a view by pass, total included.

    After a warm-up, all take turns along one gaze path. The camera turns a little from frame to frame, so
    that none reuses what another one has computed. Brief entries have 3 frames, and those that would take
    more than four seconds fewer than others, but no less.
    """
    repeats = at.settings.repeats
    path = path_around(at.settings.frame.gaze, repeats)
    passes: list[dict[str, list[float]]] = [{} for _ in entries]
    for turn in range(-_WARM_UP, repeats):
        for place, (entry, found) in enumerate(zip(entries, passes, strict=True)):
            totals = found.get("total", [])
            few = len(totals) < _LEAST_REPEATS
            if not few and (entry.briefly or sum(totals) > 1000 * _MOST_SECONDS):
                continue
            own = jittered_view(at.view, (turn + _WARM_UP) * len(entries) + place)
            # The few frames of a brief entry cover the whole path as well.
            step = len(totals) * repeats // _LEAST_REPEATS if entry.briefly else turn
            milliseconds = entry.method.render(own, path[step % repeats], turn + _WARM_UP).milliseconds
            if turn >= 0:
                for name, value in milliseconds.items():
                    found.setdefault(name, []).append(value)
        progress(turn + _WARM_UP + 1, _WARM_UP + repeats)
    return [
        {"method": entry.name, "budget": entry.budget, "passes": found}
        for entry, found in zip(entries, passes, strict=True)
    ]


def time_rows(
    by_view: Sequence[Sequence[Mapping[str, Any]]], width: int, height: int
) -> list[dict[str, Any]]:
    """One row per method and budget, of what `timed` found in each view.

    `ms` has p50, p95 and p99 of whole frames, `passes` the median of each pass, in milliseconds. `ms_range`
    is that of the views' medians; `over_ours` the median over that of OURS, of frames rendered in turns, and
    `over_ours_range` that of the views' ratios.
    """
    frames: dict[Key, list[dict[str, list[float]]]] = {}
    ours: dict[Key, list[list[float]]] = {}
    for rows in by_view:
        same = next(row["passes"]["total"] for row in rows if Key.of(row) == OURS_KEY)
        for row in rows:
            frames.setdefault(Key.of(row), []).append(row["passes"])
            ours.setdefault(Key.of(row), []).append(same)
    return [_time_row(key, frames[key], ours[key], (width, height)) for key in frames]


def _time_row(
    key: Key, views: list[dict[str, list[float]]], ours: list[list[float]], size: tuple[int, int]
) -> dict[str, Any]:
    totals = [view["total"] for view in views]
    both = [(own, same[: len(own)]) for own, same in zip(totals, ours, strict=True)]
    every = [time for own in totals for time in own]
    names = [name for name in views[0] if name != "total"]
    medians = [float(np.median(own)) for own in totals]
    ratios = [ratio_of_medians(own, same) for own, same in both]
    # A ratio of medians over all frames would be one of fast views over slow ones where times differ.
    over_ours = float(np.exp(np.mean(np.log(ratios))))
    return {
        **key._asdict(),
        "width": size[0],
        "height": size[1],
        "ms": percentiles(every, [percent for percent, least in _ENOUGH_FOR.items() if len(every) >= least]),
        "ms_range": [min(medians), max(medians)],
        "passes": {n: float(np.median([t for view in views for t in view.get(n, [])])) for n in names},
        "repeats": len(every),
        "over_ours": over_ours,
        "over_ours_range": [min(ratios), max(ratios)],
    }
