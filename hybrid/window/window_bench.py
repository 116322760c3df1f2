"""A window in use for some seconds: where the mouse moves, what counts, and another process as a load."""

from __future__ import annotations

import math
import subprocess
import sys

from compose.eye.gaze import Gaze

# Seconds before anything counts, in which kernels are compiled.
WARM_UP = 4.0
# Seconds between two movements of the mouse, about as often as mice report them, and for its whole path.
MOVE = 0.008
_ROUND = 8.0
# Where the mouse is at each of them, again and again.
MOUSE_PATH = [
    Gaze(0.5 + 0.3 * math.sin(turn), 0.5 + 0.3 * math.sin(2 * turn))
    for turn in (2 * math.pi * MOVE * step / _ROUND for step in range(round(_ROUND / MOVE)))
]
# A program that keeps a core busy for some seconds; it ends by itself, whatever becomes of the window.
_BUSY = """
import sys, time
end = time.monotonic() + float(sys.argv[1])
while time.monotonic() < end:
    pass
"""


class WindowBench:
    """Measures for `seconds`, after four of warm-up; times are those of time.perf_counter.

    For `load` seconds in the middle, another process keeps one core busy.
    """

    def __init__(self, seconds: float, load: float = 0.0):
        self._seconds, self._load = seconds, load
        self._began = math.inf
        self._busy: subprocess.Popen[bytes] | None = None
        # When the load began, and when it ended.
        self._load_times: list[float] = []

    @property
    def has_begun(self) -> bool:
        """Whether the mouse moves."""
        return self._began < math.inf

    @property
    def start(self) -> float:
        """The time from which on frames count."""
        return self._began + WARM_UP

    @property
    def loaded(self) -> tuple[float, float] | None:
        """Seconds from `start` at which the load began and ended; None if there was none."""
        if len(self._load_times) < 2:
            return None
        begin, end = self._load_times
        return begin - self.start, end - self.start

    def begin(self, now: float) -> None:
        """Begins with the warm-up."""
        self._began = now

    def gaze(self, now: float) -> Gaze:
        """Where the mouse should be."""
        return MOUSE_PATH[int((now - self._began) / MOVE) % len(MOUSE_PATH)]

    def is_over(self, now: float) -> bool:
        """Whether all is measured; starts the load when its time has come, and notes when it ends."""
        since = now - self.start - (self._seconds - self._load) / 2
        if self._busy is None and self._load and since >= 0:
            self._busy = subprocess.Popen([sys.executable, "-c", _BUSY, str(self._load)])
            self._load_times.append(now)
        elif self._busy is not None and len(self._load_times) == 1 and self._busy.poll() is not None:
            self._load_times.append(now)
        return now > self.start + self._seconds
