"""How long each way to make a frame takes, and each of its passes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from compose.view import Camera
from hybrid.evaluate.entries import Entry
from hybrid.evaluate.journal import Journal
from hybrid.timing import gaze_path, percentiles

_WARM_UP = 5
# No method is timed for longer than this, if it has so many frames at least.
_MOST_SECONDS, _LEAST_REPEATS = 80.0, 20
# Rounds between two entries in the journal.
_ROUNDS = 10


def timed(
    entries: list[Entry], camera: Camera, repeats: int, journal: Journal, progress: Callable[[int, int], None]
) -> list[dict[str, Any]]:
    """One row per entry: p50, p95 and p99 of whole frames, and the median of each pass, in milliseconds.

    All entries take turns, along one path of the gaze, after frames that warm up. What the journal holds
    already is not measured again.

    Args:
        entries: to be timed.
        camera: the view.
        repeats: frames of each; 20 of those that are timed briefly, fewer where they would take more than
            80 seconds.
        journal: keeps the times.
        progress: called with rounds done and rounds in all.
    """
    found: list[dict[str, list[float]]] = journal.once("times", lambda: [{} for _ in entries])
    path = gaze_path(repeats)
    done = max((len(passes.get("total", [])) for passes in found), default=0)
    for turn in range(-_WARM_UP if done < repeats else 0, repeats - done):
        number = done + max(turn, 0)
        for entry, passes in zip(entries, found, strict=True):
            if turn >= 0 and _is_enough(entry, passes):
                continue
            made = entry.peer.make(camera, path[number % repeats], number)
            if turn >= 0:
                for name, value in made.milliseconds.items():
                    passes.setdefault(name, []).append(value)
        if turn >= 0 and number % _ROUNDS == _ROUNDS - 1:
            journal.write()
        progress(number + 1, repeats)
    journal.write()
    return [
        {
            "method": entry.method,
            "budget": entry.budget,
            "width": camera.width,
            "height": camera.height,
            "ms": percentiles(passes["total"], (50, 95, 99)),
            "passes": {k: float(np.median(v)) for k, v in passes.items() if k != "total"},
            "repeats": len(passes["total"]),
        }
        for entry, passes in zip(entries, found, strict=True)
    ]


def _is_enough(entry: Entry, passes: dict[str, list[float]]) -> bool:
    times = passes.get("total", [])
    return len(times) >= _LEAST_REPEATS and (entry.briefly or sum(times) > 1000 * _MOST_SECONDS)
