"""Where the viewer looks: the gaze and eccentricities around it, over time from a file, or simulated."""

from __future__ import annotations

import csv
import hashlib
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError, one_line
from compose.base.files import require_size_below, write_whole
from compose.camera.camera import Array, Camera
from compose.eye.display import Display

# How far from the frame a gaze may be, in fractions of its sides: on any display that is beside the viewer,
# and float32 still holds tenths of pixels there.
FURTHEST = 1000
# Longest trace in seconds: a day.
MOST_SECONDS = 86_400.0
_COLUMNS = ["seconds", "x", "y"]
# As eye trackers of headsets give it.
_COLUMNS_OF_ANGLES = ["time_s", "gaze_x_deg", "gaze_y_deg"]
# Degrees from the line of sight straight ahead, within which a plane is seen.
_MOST_DEGREES = 89.0
# Some 40 minutes at 1,000 gazes per second.
_MOST_BYTES = 1 << 26
# Samples per second of a simulated viewer, as by a typical eye tracker.
_RATE = 120.0
# Fixations and saccades of five people in scenes of Gaussians (EyeNavGS, Ding et al. 2025): median in seconds
# and spread of the logarithm; median in degrees, spread of the logarithm, and maximum.
_FIXATION, _FIXATION_SPREAD = 0.263, 0.52
_AMPLITUDE, _AMPLITUDE_SPREAD, _MOST_AMPLITUDE = 8.4, 0.65, 35.0
# Seconds that every saccade takes, and further seconds per degree (Carpenter 1988).
_SACCADE, _SACCADE_PER_DEGREE = 0.021, 0.0022
# Margin of the frame in which the viewer never fixates, in fractions of its sides.
_MARGIN = 0.08
_TRIES = 100


@dataclass(frozen=True)
class Gaze:
    """Where the viewer looks, in fractions of the frame's width and height; may lie outside it.

    ValueError if a coordinate is not a number, or further than FURTHEST frames from the frame.
    """

    x: float = 0.5
    y: float = 0.5

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([self.x, self.y])):
            raise ValueError(f"gaze ({self.x}, {self.y}) is not a pair of finite numbers")
        if max(abs(self.x), abs(self.y)) > FURTHEST:
            raise ValueError(f"gaze ({self.x}, {self.y}) is not within {FURTHEST} frames")

    def pixel(self, width: int, height: int) -> tuple[float, float]:
        """Position (x, y) in pixels of a frame of that size."""
        return self.x * width, self.y * height


def require_within_frame(x: float, y: float) -> None:
    """UserError if a gaze around which quality is to be measured, in fractions, lies outside the frame."""
    if not (0 <= x <= 1 and 0 <= y <= 1):
        raise UserError(f"gaze {x} {y}: lies outside the frame; must be 0..1 each")


def eccentricity(camera: Camera, gaze: Gaze) -> NDArray[np.float32]:
    """(H, W) angle in degrees between each pixel's ray and the gaze's ray."""
    angle = eccentricity_at(camera, gaze, camera.pixel_centres())
    return angle.reshape(camera.height, camera.width).astype(np.float32)


def eccentricity_at(camera: Camera, gaze: Gaze, pixels: Array) -> Array:
    """(N,) angle in degrees between the rays through pixel positions (N, 2) and the gaze's ray."""
    gaze_ray = camera.rays(np.array([gaze.pixel(camera.width, camera.height)]))[0]
    rays = camera.rays(pixels)
    # arctan2 keeps its precision near zero, where arccos of a dot product loses half its digits.
    sine = np.linalg.norm(np.cross(rays, gaze_ray), axis=1)
    return np.degrees(np.arctan2(sine, rays @ gaze_ray))


@dataclass(frozen=True)
class GazeTrace:
    """A viewer's gaze at each of some times, ascending from 0."""

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

    def on(self, display: Display, width: int, height: int) -> GazeTrace:
        """The trace itself: it is of whatever frame it is used with."""
        return self

    def save(self, path: Path) -> None:
        """Writes a CSV file with the columns seconds, x, y."""
        rows = zip(self.seconds, self.gazes, strict=True)
        lines = [",".join(_COLUMNS), *(f"{s:.4f},{gaze.x:.6f},{gaze.y:.6f}" for s, gaze in rows), ""]
        write_whole(path, lambda part: part.write_text("\n".join(lines)))


@dataclass(frozen=True)
class AngularTrace:
    """A viewer's gaze at each of some times, ascending from 0, in degrees right and up of straight ahead.

    Both are angles of a plane that is seen: arc tangents of offsets in it over its distance.
    """

    seconds: tuple[float, ...]
    degrees: tuple[tuple[float, float], ...]

    def on(self, display: Display, width: int, height: int) -> GazeTrace:
        """The trace on a frame of a width and height in pixels, shown around the display's centre."""
        right, up = display.focal * np.tan(np.radians(self.degrees)).T
        places = zip((0.5 + right / width).tolist(), (0.5 - up / height).tolist(), strict=True)
        return GazeTrace(self.seconds, tuple(Gaze(x, y) for x, y in places))


def load_gaze_trace(path: Path, most_seconds: float = MOST_SECONDS) -> GazeTrace | AngularTrace:
    """A trace from a CSV file of seconds, x, y, or of time_s, gaze_x_deg, gaze_y_deg and further columns.

    Time 0 is that of the first row. UserError if the file cannot be read, has other columns or no rows, a row
    is not a gaze, time runs backwards, or the trace lasts longer than `most_seconds`.
    """
    seconds: list[float] = []
    gazes: list[tuple[float, float]] = []
    try:
        require_size_below(path, _MOST_BYTES)
        # Spreadsheets start texts with a byte order mark, and many programs end them with an empty line.
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.reader(file)
            names = [name.strip() for name in next(rows, [])]
            in_degrees = names[:3] == _COLUMNS_OF_ANGLES
            if names != _COLUMNS and not in_degrees:
                known = f"{','.join(_COLUMNS)} or {','.join(_COLUMNS_OF_ANGLES)}"
                raise UserError(f"{path}: is not a gaze trace; its first line must be {known}")
            for number, row in enumerate(rows, 2):
                if not any(cell.strip() for cell in row):
                    continue
                second, gaze = _parsed(path, number, row[: len(_COLUMNS)] if in_degrees else row, in_degrees)
                time = f"{path}: line {number}: time {row[0].strip()[:40]}"
                if not np.isfinite(second) or (seconds and second < seconds[-1]):
                    raise UserError(f"{time} must be a number, not before the line above")
                if seconds and second - seconds[0] > most_seconds:
                    found = f"{second - seconds[0]:g} s after the first one"
                    raise UserError(f"{time} is {found}; must be at most {most_seconds:g} s")
                seconds.append(second)
                gazes.append(gaze)
    except (OSError, ValueError, csv.Error) as error:
        raise UserError(f"{path}: cannot be read ({one_line(error)})") from error
    if not seconds:
        raise UserError(f"{path}: contains no gaze")
    times = tuple(second - seconds[0] for second in seconds)
    if in_degrees:
        return AngularTrace(times, tuple(gazes))
    return GazeTrace(times, tuple(Gaze(*gaze) for gaze in gazes))


def _parsed(path: Path, number: int, row: list[str], in_degrees: bool) -> tuple[float, tuple[float, float]]:
    """Time and gaze of a line."""
    try:
        second, x, y = (float(value) for value in row)
        if not in_degrees:
            # Whether there can be such a gaze.
            Gaze(x, y)
        elif not (abs(x) <= _MOST_DEGREES and abs(y) <= _MOST_DEGREES):
            raise ValueError("not in front of the viewer")
        return second, (x, y)
    except ValueError as error:
        within = f"{_MOST_DEGREES:g} degrees" if in_degrees else f"{FURTHEST} frames"
        needed = f"must be seconds, x, y, the latter within {within}"
        shown = one_line(",".join(row))
        raise UserError(f"{path}: line {number} is not a gaze ({shown}); {needed}") from error


def simulated(display: Display, width: int, height: int, duration: float, seed: int) -> GazeTrace:
    """The gaze trace of a simulated viewer, for some seconds: fixations, and saccades between them.

    The frame, of a width and height in pixels, is shown around the display's centre. Within a saccade the
    gaze follows the minimum-jerk trajectory (Hogan 1984). Same seed, same trace.
    """
    size, rng = np.array([width, height]), np.random.default_rng(seed)
    seconds = np.arange(0, duration, 1 / _RATE).tolist()
    gazes: list[Gaze] = []
    # A saccade's begin and end in seconds, start and goal (2,) in pixels; the first one leaves the centre.
    begin, end, start, goal = 0.0, 0.0, size / 2, size / 2
    for second in seconds:
        # A fixation, and the saccade after it.
        while end <= second:
            start, begin = goal, end + _FIXATION * float(np.exp(rng.normal(0, _FIXATION_SPREAD)))
            goal, degrees = _next(display, rng, start, size)
            end = begin + _SACCADE + _SACCADE_PER_DEGREE * degrees
        share = float(np.clip((second - begin) / (end - begin), 0, 1))
        x, y = (start + (goal - start) * share**3 * (10 - 15 * share + 6 * share**2)) / size
        gazes.append(Gaze(float(x), float(y)))
    return GazeTrace(tuple(seconds), tuple(gazes))


def _next(
    display: Display, rng: np.random.Generator, here: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, float]:
    """Target (2,) of a saccade in pixels, and its amplitude in degrees."""
    for _ in range(_TRIES):
        degrees = min(_AMPLITUDE * float(np.exp(rng.normal(0, _AMPLITUDE_SPREAD))), _MOST_AMPLITUDE)
        turn = rng.uniform(0, 2 * np.pi)
        there = here + degrees * display.pixels_per_degree * np.array([np.cos(turn), np.sin(turn)])
        if (there > _MARGIN * size).all() and (there < (1 - _MARGIN) * size).all():
            return there, degrees
    # The frame spans less than a degree: the eye need not move.
    return here, 0.0
