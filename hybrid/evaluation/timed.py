"""How long each way to make a frame takes, and each of its passes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.evaluation.entries import Entry
from hybrid.measure.timing import gaze_path, jittered, percentiles
from hybrid.store.journal import Journal

_WARM_UP = 5
# No method is timed for longer than this, if it has so many frames at least.
_MOST_SECONDS, _LEAST_REPEATS = 80.0, 20
# Rounds between two entries in the journal.
_ROUNDS = 10


# So many frames are needed for a percentile to be one of them, and not a guess between two.
_ENOUGH_FOR = {50: 1, 95: 20, 99: 100}


def timed(
    entries: list[Entry],
    camera: Camera,
    gaze: Gaze,
    repeats: int,
    journal: Journal,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per entry: p50, p95 and p99 of whole frames, and the median of each pass, in milliseconds.

    All entries take turns, along one path of the gaze, after frames that warm up. The camera turns a little
    from frame to frame, so that none uses what another one, be it of another entry, has found out about the
    view. What the journal holds already is not measured again. Percentiles for which there are too few frames
    are left out.

    Args:
        entries: to be timed.
        camera: the view.
        gaze: around which the path leads.
        repeats: frames of each; 20 of those that are timed briefly, fewer where they would take more than
            80 seconds.
        journal: keeps the times.
        progress: called with rounds done and rounds in all.
    """
    times: dict[str, dict[str, list[float]]] = journal.once("times", dict)
    found = [times.setdefault(entry.title, {}) for entry in entries]
    path = [_within_frame(at.x + gaze.x - 0.5, at.y + gaze.y - 0.5) for at in gaze_path(repeats)]
    done = max((len(passes.get("total", [])) for passes in found), default=0)
    for turn in range(-_WARM_UP if done < repeats else 0, repeats - done):
        number = done + max(turn, 0)
        for place, (entry, passes) in enumerate(zip(entries, found, strict=True)):
            if turn >= 0 and _is_enough(entry, passes):
                continue
            # Those that are timed briefly see the whole path as well.
            step = len(passes.get("total", [])) * repeats // _LEAST_REPEATS if entry.briefly else number
            made = entry.method.render(
                jittered(camera, (done + turn) * len(entries) + place), path[step % repeats], number
            )
            if turn >= 0:
                for name, value in made.milliseconds.items():
                    passes.setdefault(name, []).append(value)
        if turn >= 0 and number % _ROUNDS == _ROUNDS - 1:
            journal.write()
        progress(number + 1, repeats)
    journal.write()
    return [
        {
            "method": entry.name,
            "budget": entry.budget,
            "width": camera.width,
            "height": camera.height,
            "ms": percentiles(passes["total"], _known(len(passes["total"]))),
            "passes": {k: float(np.median(v)) for k, v in passes.items() if k != "total"},
            "repeats": len(passes["total"]),
        }
        for entry, passes in zip(entries, found, strict=True)
    ]


def _known(frames: int) -> list[int]:
    """Percentiles for which there are enough frames."""
    return [percent for percent, least in _ENOUGH_FOR.items() if frames >= least]


def _within_frame(x: float, y: float) -> Gaze:
    return Gaze(min(max(x, 0.0), 1.0), min(max(y, 0.0), 1.0))


def _is_enough(entry: Entry, passes: dict[str, list[float]]) -> bool:
    times = passes.get("total", [])
    return len(times) >= _LEAST_REPEATS and (entry.briefly or sum(times) > 1000 * _MOST_SECONDS)
