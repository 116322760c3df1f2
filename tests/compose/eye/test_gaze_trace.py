"""Gaze traces: files, replay, latency, and a simulated viewer."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from compose.eye.gaze_trace import GazeTrace, load_gaze_trace
from compose.eye.saccades import simulated

TRACE = GazeTrace((0.0, 0.1, 0.5), (Gaze(0.1, 0.2), Gaze(0.5, 0.5), Gaze(0.9, 0.25)))


def test_the_newest_gaze_holds_until_the_next():
    assert TRACE.at(-1) == TRACE.at(0) == TRACE.at(0.0999) == Gaze(0.1, 0.2)
    assert TRACE.at(0.1) == TRACE.at(0.4999) == Gaze(0.5, 0.5)
    assert TRACE.at(0.5) == TRACE.at(99) == Gaze(0.9, 0.25)


def test_a_file_reads_back(tmp_path):
    file = tmp_path / "gaze.csv"
    TRACE.save(file)
    assert file.read_text().splitlines()[0] == "seconds,x,y"
    assert load_gaze_trace(file) == TRACE


def test_time_is_counted_from_the_first_row(tmp_path):
    file = tmp_path / "gaze.csv"
    file.write_text("seconds, x, y\n12.5,0.5,0.5\n13,0.25,0.5\n")
    assert load_gaze_trace(file).seconds == (0, 0.5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is no gaze trace; its first line must be seconds,x,y"),
        ("t,x,y\n0,1,1\n", "is no gaze trace"),
        ("seconds,x,y\n", "holds no gaze"),
        ("seconds,x,y\n0,1\n", "line 2 is no gaze"),
        ("seconds,x,y\n0,1,1\n1,nan,0\n", "line 3 is no gaze"),
        ("seconds,x,y\n1,1,1\n0.5,0,0\n", "line 3: time 0.5 does not come after"),
    ],
)
def test_what_is_no_trace_is_named(tmp_path, text, said):
    file = tmp_path / "gaze.csv"
    file.write_text(text)
    with pytest.raises(UserError, match=said) as found:
        load_gaze_trace(file)
    assert str(file) in str(found.value)
    with pytest.raises(UserError, match="cannot be read"):
        load_gaze_trace(tmp_path / "missing.csv")


def test_a_simulated_viewer_fixates_and_jumps_as_eyes_do():
    """A third of a second per fixation, saccades of 20 to 55 ms, within the frame; same seed, same trace."""
    display = DISPLAYS["desktop"]
    trace = simulated(display, 640, 480, 60.0, seed=3)
    again = simulated(display, 640, 480, 60.0, seed=3)
    assert trace == again != simulated(display, 640, 480, 60.0, seed=4)
    assert trace.duration == pytest.approx(60, abs=0.02)
    places = np.array([(g.x * 640, g.y * 480) for g in trace.gazes])
    assert (places > 0).all()
    assert (places < [640, 480]).all()
    speed = (
        np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(trace.seconds) / display.pixels_per_degree
    )
    moving = speed > 5
    jumps = np.flatnonzero(np.diff(moving.astype(int)) == 1)
    assert 60 / len(jumps) == pytest.approx(0.36 + 0.03, rel=0.25)
    assert 0.03 < moving.mean() < 0.15
    # Peak velocities of saccades of some degrees are some hundred degrees per second.
    assert 150 < speed.max() < 700
