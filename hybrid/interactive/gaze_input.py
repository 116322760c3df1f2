"""Where the gaze comes from: the mouse or a trace, as late as an eye tracker would tell it."""

from __future__ import annotations

from collections import deque

from compose.eye.gaze import Gaze
from compose.eye.gaze_trace import GazeTrace


class GazeInput:
    """The gaze at each moment.

    Args:
        latency: seconds by which it is late.
        replayed: a trace in place of the mouse, again and again.

    Attributes:
        told: when the gaze that was told last was there, in the time that `at` is asked for: of the mouse,
            when it moved there.
    """

    def __init__(self, latency: float, replayed: GazeTrace | None):
        self.latency, self._replayed = latency, replayed
        self._began: float | None = None
        self._moves: deque[tuple[float, Gaze]] = deque()
        self._gaze, self.told = Gaze(), 0.0

    @property
    def is_live(self) -> bool:
        """Whether it is the mouse's."""
        return self._replayed is None

    def move(self, now: float, gaze: Gaze) -> None:
        """The mouse has moved."""
        if self.is_live:
            self._moves.append((now, gaze))

    def at(self, now: float) -> Gaze:
        """The newest gaze that is known."""
        if self._replayed is not None:
            if self._began is None:
                self._began = now
            self.told = now - self.latency
            seconds = self.told - self._began
            # At least an instant: a trace of one gaze has no duration.
            return self._replayed.at(seconds % max(self._replayed.duration, 1e-3) if seconds > 0 else 0.0)
        while self._moves and self._moves[0][0] <= now - self.latency:
            self.told, self._gaze = self._moves.popleft()
        return self._gaze


class GazeRecorder:
    """Records the gaze into a trace."""

    def __init__(self) -> None:
        self._seconds: list[float] = []
        self._gazes: list[Gaze] = []

    def add(self, now: float, gaze: Gaze) -> None:
        """The gaze is there now; nothing is added as long as it stays."""
        if not self._gazes or gaze != self._gazes[-1]:
            self._seconds.append(now)
            self._gazes.append(gaze)

    def trace(self) -> GazeTrace | None:
        """All of it, None if nothing was recorded."""
        if not self._seconds:
            return None
        return GazeTrace(tuple(s - self._seconds[0] for s in self._seconds), tuple(self._gazes))
