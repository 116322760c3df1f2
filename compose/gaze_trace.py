"""Where a viewer looked, over time: recorded, replayed, late, or made up with saccades."""

from __future__ import annotations

import csv
import hashlib
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compose.errors import UserError
from compose.files import write_whole
from compose.view import Display, Gaze

_COLUMNS = ["seconds", "x", "y"]
# Eye trackers' usual rate, for what is made up.
_RATE = 120.0
# Fixations while looking at scenes last 0.2 to 0.5 seconds, saccades are of some degrees, and rarely more
# than 15 (Land and Hayhoe 2001; Bahill, Adler and Stark 1975).
_FIXATION, _FIXATION_SPREAD = 0.33, 0.4
_AMPLITUDE, _MOST_AMPLITUDE = 5.0, 15.0
# Seconds that a saccade takes, and those for each of its degrees (Carpenter 1988).
_SACCADE, _SACCADE_PER_DEGREE = 0.021, 0.0022
# How near to its edge a frame is looked at, in fractions of its sides.
_MARGIN = 0.08
_TRIES = 100


@dataclass(frozen=True)
class GazeTrace:
    """A viewer's gaze at some times.

    Attributes:
        seconds: ascending, from 0 on.
        gazes: one for each, in fractions of the frame.
    """

    seconds: tuple[float, ...]
    gazes: tuple[Gaze, ...]

    @property
    def duration(self) -> float:
        """Seconds until the last of them."""
        return self.seconds[-1]

    def at(self, seconds: float) -> Gaze:
        """The newest gaze at a time; the first one before that."""
        return self.gazes[max(0, bisect_right(self.seconds, seconds) - 1)]

    def digest(self) -> str:
        """The same for the same gazes at the same times, and only for those."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    def save(self, path: Path) -> None:
        """Writes a CSV file with the columns seconds, x, y."""
        rows = [
            f"{s:.4f},{gaze.x:.6f},{gaze.y:.6f}" for s, gaze in zip(self.seconds, self.gazes, strict=True)
        ]
        text = "\n".join([",".join(_COLUMNS), *rows]) + "\n"
        write_whole(path, lambda part: part.write_text(text))


def load_gaze_trace(path: Path) -> GazeTrace:
    """A trace from a CSV file with the columns seconds, x, y; its times are counted from the first one on.

    Raises:
        UserError: the file cannot be read, has other columns or no rows, a row is no gaze, or time goes back.
    """
    try:
        with path.open(newline="") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path}: cannot be read ({error})") from error
    if not rows or [name.strip() for name in rows[0]] != _COLUMNS:
        raise UserError(f"{path}: is no gaze trace; its first line must be {','.join(_COLUMNS)}")
    seconds: list[float] = []
    gazes: list[Gaze] = []
    for number, row in enumerate(rows[1:], 2):
        try:
            second, x, y = (float(value) for value in row)
            gaze = Gaze(x, y)
        except ValueError as error:
            raise UserError(f"{path}: line {number} is no gaze ({','.join(row)})") from error
        if not np.isfinite(second) or (seconds and second < seconds[-1]):
            raise UserError(f"{path}: line {number}: time {row[0]} does not come after the line before it")
        seconds.append(second)
        gazes.append(gaze)
    if not seconds:
        raise UserError(f"{path}: holds no gaze")
    return GazeTrace(tuple(second - seconds[0] for second in seconds), tuple(gazes))


def simulated(display: Display, width: int, height: int, duration: float, seed: int) -> GazeTrace:
    """A viewer who looks around a frame of that many pixels: fixations, and saccades between them.

    The frame is shown around the display's middle. In a saccade the eye speeds up and slows down evenly
    (minimum jerk; Hogan 1984).
    """
    rng = np.random.default_rng(seed)
    size = np.array([width, height])
    here = size / 2
    until = 0.0
    path: list[tuple[float, float, np.ndarray, np.ndarray]] = []
    while until < duration:
        begin = until + _FIXATION * float(np.exp(rng.normal(0, _FIXATION_SPREAD)))
        there, degrees = _next(display, rng, here, size)
        until = begin + _SACCADE + _SACCADE_PER_DEGREE * degrees
        path.append((begin, until, here, there))
        here = there
    seconds = np.arange(0, duration, 1 / _RATE)
    places = np.empty((len(seconds), 2))
    ends = [end for _, end, _, _ in path]
    for number, second in enumerate(seconds):
        begin, end, start, goal = path[bisect_right(ends, second)]
        share = float(np.clip((second - begin) / (end - begin), 0, 1))
        places[number] = start + (goal - start) * share**3 * (10 - 15 * share + 6 * share**2)
    gazes = tuple(Gaze(float(x), float(y)) for x, y in places / size)
    return GazeTrace(tuple(seconds.tolist()), gazes)


def _next(
    display: Display, rng: np.random.Generator, here: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, float]:
    """Where a saccade goes, in pixels, and how many degrees that is."""
    for _ in range(_TRIES):
        degrees = min(float(rng.exponential(_AMPLITUDE)), _MOST_AMPLITUDE)
        turn = rng.uniform(0, 2 * np.pi)
        there = here + degrees * display.pixels_per_degree * np.array([np.cos(turn), np.sin(turn)])
        if (there > _MARGIN * size).all() and (there < (1 - _MARGIN) * size).all():
            return there, degrees
    # A frame of less than a degree: the eye need not move.
    return here, 0.0
