"""How long the frames of each method take, and their passes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.evaluation.entries import Entry
from hybrid.measure.timing import gaze_path, jittered, percentiles
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

    def row(self, camera: Camera) -> dict[str, Any]:
        """The row of the results; percentiles for which there are too few frames are left out."""
        known = [percent for percent, least in _ENOUGH_FOR.items() if len(self.totals) >= least]
        return {
            "method": self.entry.name,
            "budget": self.entry.budget,
            "width": camera.width,
            "height": camera.height,
            "ms": percentiles(self.totals, known),
            "passes": {k: float(np.median(v)) for k, v in self.passes.items() if k != "total"},
            "repeats": len(self.totals),
        }


def time_rows(
    entries: list[Entry],
    camera: Camera,
    gaze: Gaze,
    repeats: int,
    journal: Journal,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per entry: p50, p95 and p99 of whole frames, and the median of each pass, in milliseconds.

    All entries take turns along one gaze path, after a warm-up. The camera turns a little from frame to
    frame, so that no frame reuses what another one, even of another entry, has computed for its view.

    Args:
        entries: to time.
        camera: the view.
        gaze: centre of the path.
        repeats: frames per entry; 20 for those that are timed briefly, and fewer for those that would take
            over 80 seconds.
        journal: stores the times; those it holds are not measured again.
        progress: called with rounds done and rounds in total.
    """
    times: dict[str, dict[str, list[float]]] = journal.once("times", dict)
    timings = [Timing(entry, times.setdefault(entry.title, {})) for entry in entries]
    path = [_within_frame(at.x + gaze.x - 0.5, at.y + gaze.y - 0.5) for at in gaze_path(repeats)]
    done = max((len(timing.totals) for timing in timings), default=0)
    for turn in range(-_WARM_UP if done < repeats else 0, repeats - done):
        number = done + max(turn, 0)
        for place, timing in enumerate(timings):
            if turn >= 0 and timing.is_enough:
                continue
            own_camera = jittered(camera, (done + turn) * len(entries) + place)
            at = path[_step(timing, number, repeats)]
            milliseconds = timing.entry.method.render(own_camera, at, number).milliseconds
            if turn >= 0:
                timing.add(milliseconds)
        if turn >= 0 and number % _ROUNDS == _ROUNDS - 1:
            journal.write()
        progress(number + 1, repeats)
    journal.write()
    return [timing.row(camera) for timing in timings]


def _step(timing: Timing, number: int, repeats: int) -> int:
    """Step of the gaze path for an entry's next frame; the few of a brief one cover the whole path."""
    if timing.entry.briefly:
        return len(timing.totals) * repeats // _LEAST_REPEATS % repeats
    return number % repeats


def _within_frame(x: float, y: float) -> Gaze:
    return Gaze(min(max(x, 0.0), 1.0), min(max(y, 0.0), 1.0))
