"""Times of the passes of one frame."""

from __future__ import annotations

import time

import drjit as dr


class Clock:
    """Laps of one frame, each ended by waiting for the device."""

    def __init__(self) -> None:
        self._start = self._last = time.perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """Ends a pass."""
        dr.sync_thread()
        now = time.perf_counter()
        self._laps[name] = (now - self._last) * 1000
        self._last = now

    def milliseconds(self) -> dict[str, float]:
        """Of each pass, and in all (total)."""
        return {**self._laps, "total": (self._last - self._start) * 1000}
