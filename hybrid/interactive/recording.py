"""Records the gaze into CSV files."""

from __future__ import annotations

from pathlib import Path

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from compose.eye.gaze_trace import GazeTrace
from hybrid.interactive.files import unused_file


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
