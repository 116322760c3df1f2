"""How long the frames of each method take, and their passes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from compose.camera.view import View
from compose.eye.gaze import Gaze
from hybrid.evaluation.entries import Entry
from hybrid.evaluation.keys import OURS_KEY
from hybrid.measure.timing import jittered_view, medians_by_view, path_around, percentiles, ratio_of_medians
from hybrid.store.journal import Journal

_WARM_UP = 5
# Methods with at least this many frames are not timed for longer than this.
_LEAST_REPEATS, _MOST_SECONDS = 20, 80.0
# Rounds between two saves of the journal.
_ROUNDS = 10
# Frames from which on a percentile is one of them instead of a guess between two.
_ENOUGH_FOR = {50: 1, 95: 20, 99: 100}


@dataclass(frozen=True)
class Timing:
    """The times of an entry so far.

    Attributes:
        entry: what is timed.
        passes: milliseconds of each frame by pass, total included.
    """

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

    def add(self, milliseconds: dict[str, float]) -> None:
        """Adds a frame."""
        for name, value in milliseconds.items():
            self.passes.setdefault(name, []).append(value)

    def row(self, views: Sequence[View], ours: Timing | None) -> dict[str, Any]:
        """The row of the results; percentiles for which there are too few frames are left out.

        Args:
            views: that were rendered.
            ours: timing that this one is compared with, over the frames that both have; None leaves it out.
        """
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
    entries: list[Entry],
    views: Sequence[View],
    gaze: Gaze,
    repeats: int,
    journal: Journal,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per entry: p50, p95 and p99 of whole frames, and the median of each pass, in milliseconds.

    All entries take turns along one gaze path and through the views, after a warm-up. The camera turns a
    little from frame to frame, so that no frame reuses what another one, even of another entry, has computed
    for its view. `ms_range` has the least and the greatest median of a view, and `over_ours` the median over
    that of OURS, of frames that were rendered in turns.

    Args:
        entries: to time.
        views: of one size.
        gaze: centre of the path.
        repeats: frames per entry; 20 for those that are timed briefly, and fewer for those that would take
            over 80 seconds.
        journal: stores the times; those it holds are not measured again.
        progress: called with rounds done and rounds in total.
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
            at = path[_step(timing, number, repeats)]
            milliseconds = timing.entry.method.render(own, at, number).milliseconds
            if turn >= 0:
                timing.add(milliseconds)
        if turn >= 0 and number % _ROUNDS == _ROUNDS - 1:
            journal.write()
        progress(number + 1, repeats)
    journal.write()
    ours = next((timing for timing in timings if timing.entry.key == OURS_KEY), None)
    return [timing.row(views, ours) for timing in timings]


def _step(timing: Timing, number: int, repeats: int) -> int:
    """Step of the gaze path for an entry's next frame; the few of a brief one cover the whole path."""
    if timing.entry.briefly:
        return len(timing.totals) * repeats // _LEAST_REPEATS % repeats
    return number % repeats
