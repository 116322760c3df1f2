"""What an evaluation compares: methods at budgets, the quality of their frames, and how long these take."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode
from hybrid.base.identity import Journal
from hybrid.base.progress import Steps
from hybrid.evaluation.equal_cost import at_equal_time
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.evaluation.methods import Family, HybridMethod, Method, SplatsAlone
from hybrid.evaluation.results import (
    EQUAL_RAYS,
    EQUAL_TIME,
    FIXED,
    HALVES,
    HALVES_KEY,
    OURS,
    OURS_KEY,
    TOLERANCE,
    Key,
    flip_name,
    image_name,
)
from hybrid.evaluation.scoring import ScoringTask, scored_in_parallel
from hybrid.measure.frame_quality import Viewer, installed
from hybrid.measure.frame_times import (
    jittered_view,
    medians_by_view,
    path_around,
    percentiles,
    ratio_of_medians,
)
from hybrid.measure.image_metrics import ImageRegion, regions
from hybrid.measure.reference import Reference
from hybrid.render.frame_renderer import Renderer
from hybrid.render.image_files import write_png

# Samples per pixel of further fused frames, which show from which count on they surpass the splats.
OTHER_SPP = (1, 2, 4, 16)
# Frames before those that are timed.
_WARM_UP = 5
# Methods with at least this many frames are not timed for longer than this.
_LEAST_REPEATS, _MOST_SECONDS = 20, 80.0
# Rounds between two saves of the journal.
_ROUNDS = 10
# Frames from which on a percentile is one of them instead of a guess between two.
_ENOUGH_FOR = {50: 1, 95: 20, 99: 100}


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

    @property
    def title(self) -> str:
        """Name in the journal: equal for entries of the same name that render the same frames, only."""
        return ", ".join((self.name, self.budget, json.dumps(self.method.settings, sort_keys=True)))


def hybrid_entries(renderer: Renderer, settings: EvaluationSettings) -> list[Entry]:
    """Hybrid frames with each fovea mode, and fused ones with other sample counts."""

    def hybrid(mode: FoveaMode, spp: int) -> HybridMethod:
        return HybridMethod(renderer, replace(settings.frame, fovea=mode, spp=spp))

    other = [spp for spp in OTHER_SPP if spp != settings.frame.spp]
    return [
        *(Entry(f"hybrid, {mode.value}", FIXED, hybrid(mode, settings.frame.spp)) for mode in FoveaMode),
        *(Entry(f"{OURS}, {spp} spp", FIXED, hybrid(FoveaMode.FUSED, spp), briefly=True) for spp in other),
    ]


def splat_entries(splats: SplatsAlone, flat: SplatsAlone | None) -> list[Entry]:
    """Splats alone: those of the forest, and if given a model without trees."""
    entries = [Entry("splats alone", FIXED, splats)]
    return entries if flat is None else [*entries, Entry("3dgs, no forest", FIXED, flat)]


def baseline_entries(
    ours: Entry,
    known: dict[str, Family],
    views: Sequence[View],
    gaze: Gaze,
    costs: Journal,
    progress: Steps,
) -> list[Entry]:
    """Methods of families by name, with the rays of our entry in the first view, and with its time.

    One that takes more rays even at its cheapest is FIXED; one whose settings meet both budgets is included
    twice. `costs` stores the rays of equal time, so that later evaluations compare the same frames.
    """
    rays = ours.method.rays(views[0].camera, gaze)
    entries = []
    for number, (name, family) in enumerate(known.items()):
        equal = family(rays)
        affordable = equal.rays(views[0].camera, gaze) <= rays * (1 + TOLERANCE)
        entries.append(Entry(name, EQUAL_RAYS if affordable else FIXED, equal, briefly=affordable))
        met = costs.once(name, partial(at_equal_time, family, ours.method, views, gaze, rays))
        if met is not None:
            entries.append(Entry(name, EQUAL_TIME, family(met)))
        progress(number + 1, len(known))
    return entries


@dataclass(frozen=True)
class EvaluatedView:
    """An evaluated view, numbered from 0, and its regions by name; an entry of None is its reference."""

    number: int
    view: View
    reference: Reference
    regions: dict[str, ImageRegion]
    settings: EvaluationSettings
    folder: Path

    def title(self, entry: Entry | None) -> str:
        """Name in the journal of an entry's rows, which depend on the installed metrics."""
        return ", ".join((str(self.number), HALVES if entry is None else entry.title, *installed()))

    def task(self, entry: Entry | None) -> ScoringTask:
        """Renders an entry's frame and writes it; returns what to score: of the reference, its halves."""
        viewer = Viewer(self.settings.frame.display, self.settings.frame.gaze)
        if entry is None:
            write_png(self.folder / image_name(self.number, None), self.reference.radiance)
            return ScoringTask(HALVES, *self.reference.halves, (), self.regions, viewer, None)
        image = entry.method.render(self.view, viewer.gaze, self.settings.seed + self.number).image
        write_png(self.folder / image_name(self.number, entry.key), image)
        flip_file = self.folder / flip_name(self.number, entry.key)
        references = self.reference.radiance, self.reference.halves
        return ScoringTask(entry.name, image, *references, self.regions, viewer, flip_file)

    def rows(self, entry: Entry | None, journal: Journal) -> Iterator[dict[str, Any]]:
        """An entry's rows in the journal, with view, method and budget."""
        key = HALVES_KEY if entry is None else entry.key
        for row in journal[self.title(entry)]:
            yield {"view": self.number, "method": key.method, "budget": key.budget, **row}


def evaluated_views(
    views: list[View], references: list[Reference], settings: EvaluationSettings, folder: Path
) -> list[EvaluatedView]:
    """Views with their references and regions; UserError if a region is empty."""
    foveation = settings.frame.foveation
    return [
        EvaluatedView(number, view, truth, regions(foveation, truth.radiance), settings, folder)
        for number, (view, truth) in enumerate(zip(views, references, strict=True))
    ]


def quality_rows(
    entries: list[Entry], views: list[EvaluatedView], journal: Journal, progress: Steps
) -> list[dict[str, Any]]:
    """Rows of view, method, budget, region, metric and value; writes images unless the journal has them."""
    wanted = [(view, entry) for view in views for entry in (None, *entries)]
    missing = [(view, entry) for view, entry in wanted if view.title(entry) not in journal]
    tasks = ((view.title(entry), view.task(entry)) for view, entry in missing)
    done = len(wanted) - len(missing)
    for number, (title, rows) in enumerate(scored_in_parallel(tasks)):
        journal[title] = rows
        progress(done + number + 1, len(wanted))
    return [row for view, entry in wanted for row in view.rows(entry, journal)]


@dataclass(frozen=True)
class Timing:
    """The times of an entry so far: milliseconds of each frame by pass, total included."""

    entry: Entry
    passes: dict[str, list[float]]

    @property
    def totals(self) -> list[float]:
        """Milliseconds of each whole frame."""
        return self.passes.get("total", [])

    @property
    def is_enough(self) -> bool:
        """Whether it may end with fewer frames than were asked for."""
        few = len(self.totals) < _LEAST_REPEATS
        return not few and (self.entry.briefly or sum(self.totals) > 1000 * _MOST_SECONDS)

    def row(self, views: Sequence[View], ours: Timing | None) -> dict[str, Any]:
        """The row of the results, compared with `ours`, if there is one, over the frames that both have."""
        known = [percent for percent, least in _ENOUGH_FOR.items() if len(self.totals) >= least]
        row = {
            "method": self.entry.name,
            "budget": self.entry.budget,
            "width": views[0].camera.width,
            "height": views[0].camera.height,
            "ms": percentiles(self.totals, known),
            "passes": {k: float(np.median(v)) for k, v in self.passes.items() if k != "total"},
            "repeats": len(self.totals),
        }
        if len(views) > 1:
            medians = medians_by_view(self.totals, len(views))
            row["ms_range"] = [min(medians), max(medians)]
        if ours is not None:
            both = min(len(self.totals), len(ours.totals))
            row["over_ours"] = ratio_of_medians(self.totals[:both], ours.totals[:both])
        return row


def time_rows(
    entries: list[Entry], views: Sequence[View], gaze: Gaze, repeats: int, journal: Journal, progress: Steps
) -> list[dict[str, Any]]:
    """One row per entry: p50, p95 and p99 of whole frames, and the median of each pass, in milliseconds.

    After a warm-up, all take turns along one gaze path around `gaze` and through the views, of one size. The
    camera turns a little from frame to frame, so that none reuses what another one has computed. Brief
    entries have 20 frames instead of `repeats`, those that would take over 80 seconds fewer. `ms_range` is
    that of the views' medians, `over_ours` the median over that of OURS, of frames rendered in turns.
    """
    times: dict[str, dict[str, list[float]]] = journal.once("times", dict)
    timings = [Timing(entry, times.setdefault(entry.title, {})) for entry in entries]
    path = path_around(gaze, repeats)
    done = max((len(timing.totals) for timing in timings), default=0)
    for turn in range(-_WARM_UP if done < repeats else 0, repeats - done):
        number = done + max(turn, 0)
        for place, timing in enumerate(timings):
            if turn >= 0 and timing.is_enough:
                continue
            # Of a brief entry as well, frame n is of view n.
            view = views[(len(timing.totals) if turn >= 0 else place) % len(views)]
            own = jittered_view(view, (done + turn) * len(entries) + place)
            # The few frames of a brief entry cover the whole path as well.
            step = len(timing.totals) * repeats // _LEAST_REPEATS if timing.entry.briefly else number
            milliseconds = timing.entry.method.render(own, path[step % repeats], number).milliseconds
            if turn >= 0:
                for name, value in milliseconds.items():
                    timing.passes.setdefault(name, []).append(value)
        if turn >= 0 and number % _ROUNDS == _ROUNDS - 1:
            journal.write()
        progress(number + 1, repeats)
    journal.write()
    ours = next((timing for timing in timings if timing.entry.key == OURS_KEY), None)
    return [timing.row(views, ours) for timing in timings]
