"""Where a viewer looked over time, from a file or to a file."""

from __future__ import annotations

import csv
import hashlib
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compose.base.errors import UserError, one_line
from compose.base.files import require_size_below, write_whole
from compose.eye.gaze import FURTHEST, Gaze

_COLUMNS = ["seconds", "x", "y"]
# Some 40 minutes at 1,000 gazes per second.
_MOST_BYTES = 1 << 26
# Longest trace in seconds: a day.
MOST_SECONDS = 86_400.0


@dataclass(frozen=True)
class GazeTrace:
    """A viewer's gaze at ascending times.

    Attributes:
        seconds: times, ascending from 0.
        gazes: gaze at each of these times, in fractions of the frame.
    """

    seconds: tuple[float, ...]
    gazes: tuple[Gaze, ...]

    @property
    def duration(self) -> float:
        """Time of the last gaze in seconds."""
        return self.seconds[-1]

    def at(self, seconds: float) -> Gaze:
        """The latest gaze up to a time; before the first one, the first."""
        return self.gazes[max(0, bisect_right(self.seconds, seconds) - 1)]

    def digest(self) -> str:
        """16 hexadecimal digits, the same for equal traces only."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def save(self, path: Path) -> None:
        """Writes a CSV file with the columns seconds, x, y."""
        rows = [
            f"{s:.4f},{gaze.x:.6f},{gaze.y:.6f}" for s, gaze in zip(self.seconds, self.gazes, strict=True)
        ]
        text = "\n".join([",".join(_COLUMNS), *rows]) + "\n"
        write_whole(path, lambda part: part.write_text(text))


def load_gaze_trace(path: Path, most_seconds: float = MOST_SECONDS) -> GazeTrace:
    """A trace from a CSV file with the columns seconds, x, y; time 0 is that of the first row.

    Args:
        path: of the file.
        most_seconds: longest duration.

    Raises:
        UserError: the file cannot be read, has other columns or no rows, a row is not a gaze, time runs
            backwards, or the trace is too long.
    """
    seconds: list[float] = []
    gazes: list[Gaze] = []
    try:
        require_size_below(path, _MOST_BYTES)
        with path.open(newline="") as file:
            rows = csv.reader(file)
            if [name.strip() for name in next(rows, [])] != _COLUMNS:
                raise UserError(f"{path}: is not a gaze trace; its first line must be {','.join(_COLUMNS)}")
            for number, row in enumerate(rows, 2):
                second, gaze = _parsed(path, number, row)
                _check_time(
                    f"{path}: line {number}: time {row[0].strip()[:40]}", second, seconds, most_seconds
                )
                seconds.append(second)
                gazes.append(gaze)
    except (OSError, ValueError, csv.Error) as error:
        raise UserError(f"{path}: cannot be read ({one_line(error)})") from error
    if not seconds:
        raise UserError(f"{path}: contains no gaze")
    return GazeTrace(tuple(second - seconds[0] for second in seconds), tuple(gazes))


def _parsed(path: Path, number: int, row: list[str]) -> tuple[float, Gaze]:
    """Time and gaze of a line."""
    try:
        second, x, y = (float(value) for value in row)
        return second, Gaze(x, y)
    except ValueError as error:
        shown = one_line(",".join(row))
        raise UserError(
            f"{path}: line {number} is not a gaze ({shown}); must be seconds, x, y, the latter within "
            f"{FURTHEST} frames"
        ) from error


def _check_time(what: str, second: float, earlier: list[float], most_seconds: float) -> None:
    """Raises UserError if a time is none, runs backwards, or is too late; `what` names it."""
    if not np.isfinite(second) or (earlier and second < earlier[-1]):
        raise UserError(f"{what} must be a number, not before the line above")
    if earlier and second - earlier[0] > most_seconds:
        raise UserError(
            f"{what} is {second - earlier[0]:g} s after the first one; must be at most {most_seconds:g} s"
        )
