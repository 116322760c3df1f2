"""The gaze from the mouse or a trace, as late as an eye tracker would report it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from compose.eye.gaze import Gaze
from compose.eye.gaze_trace import GazeTrace


@dataclass(frozen=True)
class TimedGaze:
    """A gaze and when the viewer looked there.

    Attributes:
        gaze: in fractions of the frame.
        time: seconds, on the clock of the caller; of the mouse, when it moved there.
    """

    gaze: Gaze
    time: float


class GazeInput:
    """Reports the gaze at each moment.

    Args:
        latency: seconds from a gaze to its report.
        trace: replayed in a loop instead of the mouse; None for the mouse.

    Attributes:
        last: the gaze that was last reported.
    """

    def __init__(self, latency: float, trace: GazeTrace | None):
        self._latency, self._trace = latency, trace
        self._began: float | None = None
        self._moves: deque[TimedGaze] = deque()
        self.last = TimedGaze(Gaze(), 0.0)

    @property
    def changes_by_itself(self) -> bool:
        """Whether the gaze may change at other moments than when the mouse moves."""
        return self._trace is not None or self._latency > 0

    def move(self, now: float, gaze: Gaze) -> None:
        """Notes that the mouse has moved; ignored while a trace is replayed."""
        if self._trace is None:
            self._moves.append(TimedGaze(gaze, now))

    def at(self, now: float) -> TimedGaze:
        """The newest gaze that is known at a time."""
        known = now - self._latency
        if self._trace is not None:
            self.last = TimedGaze(self._replayed(self._trace, now, known), known)
        while self._moves and self._moves[0].time <= known:
            self.last = self._moves.popleft()
        return self.last

    def _replayed(self, trace: GazeTrace, now: float, known: float) -> Gaze:
        """The gaze of a trace that begins when it is first asked for."""
        if self._began is None:
            self._began = now
        seconds = known - self._began
        # Not zero: a trace of one gaze has no duration.
        return trace.at(seconds % max(trace.duration, 1e-3) if seconds > 0 else 0.0)
