"""Times of the passes of one frame."""

from __future__ import annotations

import time

import drjit as dr


class Clock:
    """Measures consecutive passes. A pass ends when the device has finished its work."""

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
        """Milliseconds of each pass, and of all passes together ("total")."""
        return {**self._laps, "total": (self._last - self._start) * 1000}
