"""A simulated viewer: fixations, and saccades between them."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.eye.gaze_trace import GazeTrace

# Samples per second, as of a typical eye tracker.
_RATE = 120.0
# Fixations while viewing scenes last 0.2 to 0.5 seconds; saccades span a few degrees, rarely more than 15
# (Land and Hayhoe 2001; Bahill, Adler and Stark 1975). Here: median in seconds and spread of the logarithm;
# mean and maximum in degrees.
_FIXATION, _FIXATION_SPREAD = 0.33, 0.4
_AMPLITUDE, _MOST_AMPLITUDE = 5.0, 15.0
# Seconds that every saccade takes, and further seconds per degree (Carpenter 1988).
_SACCADE, _SACCADE_PER_DEGREE = 0.021, 0.0022
# Margin of the frame in which the viewer never fixates, in fractions of its sides.
_MARGIN = 0.08
_TRIES = 100


def simulated(display: Display, width: int, height: int, duration: float, seed: int) -> GazeTrace:
    """The gaze trace of a simulated viewer who looks around a frame: fixations, and saccades between them.

    Within a saccade the gaze follows the minimum-jerk trajectory (Hogan 1984).

    Args:
        display: the frame is shown around its centre.
        width, height: frame in pixels.
        duration: seconds.
        seed: same seed, same trace.
    """
    size = np.array([width, height])
    saccades = _saccades(display, size, duration, np.random.default_rng(seed))
    ends = [saccade.end for saccade in saccades]
    seconds = np.arange(0, duration, 1 / _RATE)
    positions = np.empty((len(seconds), 2))
    for number, second in enumerate(seconds):
        positions[number] = saccades[bisect_right(ends, second)].at(second)
    gazes = tuple(Gaze(float(x), float(y)) for x, y in positions / size)
    return GazeTrace(tuple(seconds.tolist()), gazes)


@dataclass(frozen=True)
class _Saccade:
    """A saccade, and the fixation before it.

    Attributes:
        begin, end: seconds.
        start, goal: (2,) in pixels.
    """

    begin: float
    end: float
    start: np.ndarray
    goal: np.ndarray

    def at(self, second: float) -> np.ndarray:
        """(2,) gaze in pixels at a time up to the end."""
        share = float(np.clip((second - self.begin) / (self.end - self.begin), 0, 1))
        return self.start + (self.goal - self.start) * share**3 * (10 - 15 * share + 6 * share**2)


def _saccades(
    display: Display, size: np.ndarray, duration: float, rng: np.random.Generator
) -> list[_Saccade]:
    """Saccades, the first from the centre of a frame of size (2,), until the duration is over."""
    here = size / 2
    end = 0.0
    saccades: list[_Saccade] = []
    while end < duration:
        begin = end + _FIXATION * float(np.exp(rng.normal(0, _FIXATION_SPREAD)))
        there, degrees = _next(display, rng, here, size)
        end = begin + _SACCADE + _SACCADE_PER_DEGREE * degrees
        saccades.append(_Saccade(begin, end, here, there))
        here = there
    return saccades


def _next(
    display: Display, rng: np.random.Generator, here: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, float]:
    """Target (2,) of a saccade in pixels, and its amplitude in degrees."""
    for _ in range(_TRIES):
        degrees = min(float(rng.exponential(_AMPLITUDE)), _MOST_AMPLITUDE)
        turn = rng.uniform(0, 2 * np.pi)
        there = here + degrees * display.pixels_per_degree * np.array([np.cos(turn), np.sin(turn)])
        if (there > _MARGIN * size).all() and (there < (1 - _MARGIN) * size).all():
            return there, degrees
    # The frame spans less than a degree: the eye need not move.
    return here, 0.0
