"""The gaze from the mouse or a trace, as late as an eye tracker reports it, and its recording in files."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path

from compose.base.errors import UserError
from compose.eye.gaze import Gaze, GazeTrace


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


def unused_file(folder: Path, name: str, suffix: str) -> Path:
    """FOLDER/NAME-001SUFFIX, with the lowest number that no file there has yet.

    Raises:
        UserError: the folder cannot be read.
    """
    number = 1
    try:
        while (folder / f"{name}-{number:03d}{suffix}").exists():
            number += 1
    except OSError as error:
        raise UserError(f"{folder}: cannot be read ({error.strerror})") from error
    return folder / f"{name}-{number:03d}{suffix}"


class GazeRecording:
    """A recording of the gaze that is started and stopped with one key.

    Args:
        folder: where the files go.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._running = False
        self._seconds: list[float] = []
        self._gazes: list[Gaze] = []

    def add(self, now: float, gaze: Gaze) -> None:
        """Adds the gaze at a time in seconds; ignored if nothing is recorded, or if it has not changed."""
        if self._running and (not self._gazes or gaze != self._gazes[-1]):
            self._seconds.append(now)
            self._gazes.append(gaze)

    def toggle(self, name: str) -> str:
        """Starts recording, or writes what was recorded to NAME-gaze-001.csv or the next free number.

        If the file cannot be written, the recording continues.

        Returns:
            A message for the user.
        """
        if not self._running:
            self._running = True
            return "recording the gaze"
        try:
            message = self._write(f"{name}-gaze")
        except UserError as error:
            return str(error)
        self._running = False
        self._seconds.clear()
        self._gazes.clear()
        return message

    def _write(self, name: str) -> str:
        if not self._gazes:
            return "no gaze was recorded"
        file = unused_file(self._folder, name, ".csv")
        start = self._seconds[0]
        GazeTrace(tuple(second - start for second in self._seconds), tuple(self._gazes)).save(file)
        return str(file)
