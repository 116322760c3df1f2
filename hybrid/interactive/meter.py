"""When frames were shown: the time between them, and from the gaze to the screen."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

# Recent frames whose percentiles are shown while the window runs.
_RECENT = 100


class Timed(NamedTuple):
    """A duration that ended when a frame was shown.

    Attributes:
        at: time.perf_counter of that frame.
        seconds: the duration.
    """

    at: float
    seconds: float


class Meter:
    """Collects the times of shown frames.

    All times are of time.perf_counter.

    Args:
        keeps_all: whether to keep every frame, or only the last hundred.

    Attributes:
        intervals: from each frame to the next one.
        latencies: from each gaze movement to the first frame that includes it or a newer one.
        passes: milliseconds of each pass, by name, of each frame.
    """

    def __init__(self, keeps_all: bool = False):
        most = None if keeps_all else _RECENT
        self.intervals: deque[Timed] = deque(maxlen=most)
        self.latencies: deque[Timed] = deque(maxlen=most)
        self.passes: deque[dict[str, float]] = deque(maxlen=most)
        self._movements: deque[float] = deque(maxlen=10 * _RECENT)
        self._last: float | None = None

    def moved(self, gaze_time: float) -> None:
        """Notes that the gaze moved at that time."""
        self._movements.append(gaze_time)

    def pause(self) -> None:
        """Notes that no frames come for a while, for another reason than that they are slow."""
        self._movements.clear()
        self._last = None

    def shown(self, at: float, gaze_time: float, passes: dict[str, float]) -> None:
        """Notes that a frame is on the screen which includes all movements up to `gaze_time`."""
        self.passes.append(passes)
        while self._movements and self._movements[0] <= gaze_time:
            self.latencies.append(Timed(at, at - self._movements.popleft()))
        if self._last is not None:
            self.intervals.append(Timed(at, at - self._last))
        self._last = at
