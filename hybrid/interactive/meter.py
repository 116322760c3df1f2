"""Times of shown frames: how often they come, and how long after the events that they answer."""

from __future__ import annotations

from collections import deque

# As many as anyone wants to see percentiles of while the window runs.
_RECENT = 100


class Meter:
    """Collects when frames were shown.

    Args:
        all_of_them: whether everything is kept, or only what is recent.

    Attributes:
        intervals: seconds between frames, each after the time at which it ended.
        latencies: seconds from each event to the first frame that knows of it or of a newer one, after the
            time of that frame.
        passes: milliseconds of each pass of the frames.
    """

    def __init__(self, all_of_them: bool = False):
        most = None if all_of_them else _RECENT
        self.intervals: deque[tuple[float, float]] = deque(maxlen=most)
        self.latencies: deque[tuple[float, float]] = deque(maxlen=most)
        self.passes: deque[dict[str, float]] = deque(maxlen=most)
        self._events: deque[float] = deque(maxlen=10 * _RECENT)
        self._last: float | None = None

    def event(self, at: float) -> None:
        """The gaze has moved."""
        self._events.append(at)

    def pause(self) -> None:
        """No frames are made for a while, for another reason than that they take so long."""
        self._events.clear()
        self._last = None

    def shown(self, at: float, asked: float, passes: dict[str, float]) -> None:
        """A frame is on the screen that knows of all events until `asked`."""
        self.passes.append(passes)
        while self._events and self._events[0] <= asked:
            self.latencies.append((at, at - self._events.popleft()))
        if self._last is not None:
            self.intervals.append((at, at - self._last))
        self._last = at
