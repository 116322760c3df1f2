"""A simulated viewer: fixations, and saccades between them."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.eye.gaze_trace import GazeTrace

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
