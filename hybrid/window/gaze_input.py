"""The gaze from the mouse or a trace, as late as an eye tracker reports it, and its recording in files."""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from compose.base.errors import UserError
from compose.eye.gaze import Gaze, GazeTrace


@dataclass(frozen=True)
class TimedGaze:
    """A gaze, and the time in seconds when the viewer looked or the mouse moved there."""

    gaze: Gaze
    time: float


class GazeInput:
    """Reports the gaze at each moment, `latency` seconds late; `last` is the one that was last reported.

    The trace, unless None, is replayed in a loop instead of the mouse.
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
            # A trace begins when it is first asked for.
            self._began = now if self._began is None else self._began
            seconds = known - self._began
            # Not modulo zero: a trace of one gaze has no duration.
            place = seconds % max(self._trace.duration, 1e-3) if seconds > 0 else 0.0
            self.last = TimedGaze(self._trace.at(place), known)
        while self._moves and self._moves[0].time <= known:
            self.last = self._moves.popleft()
        return self.last


def unused_file(folder: Path, name: str, suffix: str) -> Path:
    """FOLDER/NAME-001SUFFIX, or the next number without a file; UserError if the folder cannot be read."""
    files = (folder / f"{name}-{number:03d}{suffix}" for number in itertools.count(1))
    try:
        return next(file for file in files if not file.exists())
    except OSError as error:
        raise UserError(f"{folder}: cannot be read ({error.strerror})") from error


class GazeRecording:
    """A recording of the gaze that is started and stopped with one key, and its file in a folder."""

    def __init__(self, folder: Path):
        self._folder = folder
        # None while nothing is recorded.
        self._recorded: list[TimedGaze] | None = None

    def add(self, now: float, gaze: Gaze) -> None:
        """Adds the gaze at a time in seconds; ignored if nothing is recorded, or if it has not changed."""
        recorded = self._recorded
        if recorded is not None and (not recorded or gaze != recorded[-1].gaze):
            recorded.append(TimedGaze(gaze, now))

    def toggle(self, name: str) -> str:
        """Starts recording, or writes what was recorded to NAME-gaze-001.csv or the next free number.

        If the file cannot be written, the recording continues. Returns a message for the user.
        """
        recorded = self._recorded
        if recorded is None:
            self._recorded = []
            return "recording the gaze"
        message = "no gaze was recorded"
        if recorded:
            seconds = tuple(one.time - recorded[0].time for one in recorded)
            try:
                file = unused_file(self._folder, f"{name}-gaze", ".csv")
                GazeTrace(seconds, tuple(one.gaze for one in recorded)).save(file)
            except UserError as error:
                return str(error)
            message = str(file)
        self._recorded = None
        return message
