"""The gaze from the mouse or a trace, late or not; and its recording."""

from __future__ import annotations

import pytest

from compose.eye.gaze import Gaze
from compose.eye.gaze_trace import GazeTrace
from hybrid.interactive.gaze_input import GazeInput, GazeRecorder
from hybrid.interactive.meter import Meter

HERE, THERE, BEYOND = Gaze(0.1, 0.2), Gaze(0.7, 0.8), Gaze(0.3, 0.9)


def test_the_mouse_is_the_gaze():
    gaze = GazeInput(0.0, None)
    assert gaze.at(5.0) == Gaze()
    gaze.move(5.0, HERE)
    gaze.move(5.1, THERE)
    assert gaze.at(5.1) == THERE


def test_a_late_gaze_is_the_mouse_of_a_while_ago():
    gaze = GazeInput(0.5, None)
    gaze.move(1.0, HERE)
    gaze.move(2.0, THERE)
    assert gaze.at(1.4) == Gaze()
    assert gaze.at(1.5) == HERE
    assert gaze.at(2.4) == HERE
    assert gaze.at(9.0) == THERE


def test_a_trace_goes_round_and_the_mouse_does_not_matter():
    gaze = GazeInput(0.0, GazeTrace((0.0, 1.0, 2.0), (HERE, THERE, BEYOND)))
    gaze.move(100.0, Gaze(0.5, 0.5))
    assert [gaze.at(100.0 + s) for s in (0, 0.9, 1.1, 2.05, 3.1)] == [HERE, HERE, THERE, HERE, THERE]


def test_a_late_trace_begins_late():
    gaze = GazeInput(0.3, GazeTrace((0.0, 1.0, 2.0), (HERE, THERE, BEYOND)))
    assert [gaze.at(s) for s in (50, 51.2, 51.4)] == [HERE, HERE, THERE]


def test_latency_delays_everything_but_the_beginning():
    trace = GazeTrace((0.0, 0.1, 0.5, 9.0), (HERE, THERE, BEYOND, BEYOND))
    late, prompt = GazeInput(0.2, trace), GazeInput(0.0, trace)
    for second in (0, 0.15, 0.25, 0.5, 0.69, 0.71, 2):
        assert late.at(second) == trace.at(second - 0.2)
        assert prompt.at(second) == trace.at(second)


def test_what_is_recorded_is_replayed():
    recorder = GazeRecorder()
    assert recorder.trace() is None
    for now, gaze in ((3.0, HERE), (3.1, HERE), (3.5, THERE), (4.0, THERE)):
        recorder.add(now, gaze)
    assert recorder.trace() == GazeTrace((0.0, 0.5), (HERE, THERE))


def test_latency_counts_to_the_first_frame_that_knows_of_an_event():
    meter = Meter()
    for at in (0.00, 0.01, 0.02):
        meter.event(at)
    meter.shown(0.07, asked=0.01, passes={})
    meter.shown(0.13, asked=0.02, passes={})
    meter.shown(0.20, asked=0.02, passes={})
    assert [seconds for _, seconds in meter.latencies] == pytest.approx([0.07, 0.06, 0.11])
    assert [seconds for _, seconds in meter.intervals] == pytest.approx([0.06, 0.07])


def test_only_what_is_recent_is_kept_unless_all_is_wanted():
    meters = Meter(), Meter(all_of_them=True)
    for meter in meters:
        for number in range(1000):
            meter.event(number)
            meter.shown(number + 0.5, number, {})
    assert [len(meter.intervals) for meter in meters] == [100, 999]
    assert [len(meter.latencies) for meter in meters] == [100, 1000]


def test_what_is_told_is_dated_when_it_was_there():
    late = GazeInput(0.5, None)
    late.move(1.0, HERE)
    late.move(2.0, THERE)
    for now, told in ((1.6, 1.0), (2.4, 1.0), (2.6, 2.0), (9.0, 2.0)):
        late.at(now)
        assert late.told == told
    replayed = GazeInput(0.5, GazeTrace((0.0, 1.0), (HERE, THERE)))
    replayed.at(7.0)
    assert replayed.told == 6.5


def test_a_pause_counts_neither_as_a_frame_nor_as_latency():
    meter = Meter()
    meter.shown(1.0, 1.0, {})
    meter.event(1.5)
    meter.pause()
    meter.shown(30.0, 30.0, {})
    meter.event(30.1)
    meter.shown(30.2, 30.1, {})
    assert [seconds for _, seconds in meter.intervals] == pytest.approx([0.2])
    assert [seconds for _, seconds in meter.latencies] == pytest.approx([0.1])
