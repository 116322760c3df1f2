"""The simulated viewer, against what is known of eyes."""

from __future__ import annotations

import numpy as np
import pytest

from compose.eye.display import DISPLAYS, Display
from compose.eye.gaze import GazeTrace, simulated

DISPLAY = DISPLAYS["desktop"]
RATE = 120


def positions_of(trace: GazeTrace, width: int, height: int) -> np.ndarray:
    """(T, 2) in pixels."""
    return np.array([(gaze.x * width, gaze.y * height) for gaze in trace.gazes])


@pytest.fixture(scope="module")
def long() -> np.ndarray:
    """(T, 2) in degrees: five minutes on a frame so large that its edges hardly matter."""
    trace = simulated(DISPLAY, 30_000, 30_000, 300.0, seed=1)
    return positions_of(trace, 30_000, 30_000) / DISPLAY.pixels_per_degree


def fixations(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Complete fixations: durations (F,) in seconds, and positions (F, 2)."""
    still = (np.diff(positions, axis=0) == 0).all(axis=1)
    starts = np.flatnonzero(np.diff(still.astype(int)) == 1) + 1
    ends = np.flatnonzero(np.diff(still.astype(int)) == -1) + 1
    ends = ends[ends > starts[0]]
    count = min(len(starts), len(ends))
    return (ends[:count] - starts[:count] + 1) / RATE, positions[starts[:count]]


def test_the_same_seed_gives_the_same_trace():
    trace = simulated(DISPLAY, 640, 480, 10.0, seed=3)
    assert trace == simulated(DISPLAY, 640, 480, 10.0, seed=3)
    assert trace != simulated(DISPLAY, 640, 480, 10.0, seed=4)


def test_the_trace_covers_the_duration_at_the_rate_of_an_eye_tracker():
    trace = simulated(DISPLAY, 640, 480, 10.0, seed=3)
    np.testing.assert_allclose(np.diff(trace.seconds), 1 / RATE)
    assert trace.seconds[0] == 0
    assert trace.duration == pytest.approx(10, abs=0.02)
    assert (trace.gazes[0].x, trace.gazes[0].y) == (0.5, 0.5)


def test_the_gaze_stays_off_the_edges_and_goes_everywhere_else():
    found = positions_of(simulated(DISPLAY, 640, 480, 120.0, seed=3), 640, 480) / [640, 480]
    assert (found > 0.08).all()
    assert (found < 0.92).all()
    assert (found.min(axis=0) < 0.12).all()
    assert (found.max(axis=0) > 0.88).all()


def test_fixations_are_those_of_people(long):
    """Log-normal: median 0.263 s, spread 0.52. Of five people: 0.223 to 0.293 s, 90 % 0.441 to 0.667."""
    durations, _ = fixations(long)
    assert len(durations) > 700
    assert np.median(durations) == pytest.approx(0.263, abs=0.02)
    assert np.log(durations).std() == pytest.approx(0.52, abs=0.04)
    assert 0.441 < np.quantile(durations, 0.9) < 0.667


def test_amplitudes_of_saccades_are_those_of_people(long):
    """Log-normal; median 8.4 degrees, spread 0.65. Of five people: 7.4 to 9.9, 90 % 14.0 to 23.6."""
    _, at = fixations(long)
    amplitude = np.linalg.norm(np.diff(at, axis=0), axis=1)
    assert amplitude.max() == pytest.approx(35, abs=1e-6)
    assert np.median(amplitude) == pytest.approx(8.4, abs=0.7)
    assert 14.0 < np.quantile(amplitude, 0.9) < 23.6
    # In no direction more often than in another.
    assert np.abs(np.mean(np.diff(at, axis=0), axis=0)).max() < 1


def test_saccades_are_as_frequent_as_those_of_people(long):
    """Of five people, 2.45 to 3.27 a second."""
    durations, _ = fixations(long)
    assert 2.45 < len(durations) / (len(long) / RATE) < 3.27


def test_larger_saccades_take_longer_and_are_faster(long):
    """21 ms and 2.2 ms per degree; a minimum-jerk movement peaks at 1.875 times its mean speed."""
    _, at = fixations(long)
    speed = np.linalg.norm(np.diff(long, axis=0), axis=1) * RATE
    moving = speed > 0
    amplitude = np.linalg.norm(np.diff(at, axis=0), axis=1)
    expected = (0.021 + 0.0022 * amplitude).sum()
    # A movement that begins and ends between two samples is seen over one step more, on average.
    assert moving.sum() / RATE - len(amplitude) / RATE == pytest.approx(expected, rel=0.05)
    assert speed.max() == pytest.approx(1.875 * 35 / (0.021 + 0.0022 * 35), rel=0.05)


def test_a_frame_smaller_than_any_saccade_is_fixated_in_the_middle():
    dense = Display(10**9, 10**9, 55.0)
    trace = simulated(dense, 100, 100, 2.0, seed=0)
    assert {(gaze.x, gaze.y) for gaze in trace.gazes} == {(0.5, 0.5)}
