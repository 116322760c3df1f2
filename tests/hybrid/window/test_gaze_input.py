"""The gaze from the mouse or a trace, with and without latency."""

from __future__ import annotations

from compose.eye.gaze import Gaze, GazeTrace
from hybrid.window.gaze_input import GazeInput, TimedGaze

HERE, THERE, BEYOND = Gaze(0.1, 0.2), Gaze(0.7, 0.8), Gaze(0.3, 0.9)


def test_the_mouse_is_the_gaze():
    gaze = GazeInput(0.0, None)
    assert gaze.at(5.0).gaze == Gaze()
    gaze.move(5.0, HERE)
    gaze.move(5.1, THERE)
    assert gaze.at(5.1).gaze == THERE


def test_a_late_gaze_is_where_the_mouse_was_a_while_ago():
    gaze = GazeInput(0.5, None)
    gaze.move(1.0, HERE)
    gaze.move(2.0, THERE)
    assert gaze.at(1.4).gaze == Gaze()
    assert gaze.at(1.5).gaze == HERE
    assert gaze.at(2.4).gaze == HERE
    assert gaze.at(9.0).gaze == THERE


def test_a_trace_repeats_and_ignores_the_mouse():
    gaze = GazeInput(0.0, GazeTrace((0.0, 1.0, 2.0), (HERE, THERE, BEYOND)))
    gaze.move(100.0, Gaze(0.5, 0.5))
    seen = [gaze.at(100.0 + s).gaze for s in (0, 0.9, 1.1, 2.05, 3.1)]
    assert seen == [HERE, HERE, THERE, HERE, THERE]


def test_a_trace_begins_when_it_is_first_asked_for():
    gaze = GazeInput(0.3, GazeTrace((0.0, 1.0, 2.0), (HERE, THERE, BEYOND)))
    assert [gaze.at(s).gaze for s in (50, 51.2, 51.4)] == [HERE, HERE, THERE]


def test_latency_delays_a_trace_except_for_its_beginning():
    trace = GazeTrace((0.0, 0.1, 0.5, 9.0), (HERE, THERE, BEYOND, BEYOND))
    late, prompt = GazeInput(0.2, trace), GazeInput(0.0, trace)
    for second in (0, 0.15, 0.25, 0.5, 0.69, 0.71, 2):
        assert late.at(second).gaze == trace.at(second - 0.2)
        assert prompt.at(second).gaze == trace.at(second)


def test_a_trace_of_one_gaze_stays_there():
    gaze = GazeInput(0.0, GazeTrace((0.0,), (HERE,)))
    assert [gaze.at(s).gaze for s in (1.0, 1.5, 99.0)] == [HERE, HERE, HERE]


def test_a_gaze_carries_the_time_at_which_the_viewer_looked_there():
    late = GazeInput(0.5, None)
    late.move(1.0, HERE)
    late.move(2.0, THERE)
    for now, time in ((1.6, 1.0), (2.4, 1.0), (2.6, 2.0), (9.0, 2.0)):
        assert late.at(now).time == time
    replayed = GazeInput(0.5, GazeTrace((0.0, 1.0), (HERE, THERE)))
    assert replayed.at(7.0).time == 6.5


def test_the_last_reported_gaze_is_kept():
    gaze = GazeInput(0.5, None)
    assert gaze.last == TimedGaze(Gaze(), 0.0)
    gaze.move(1.0, HERE)
    assert gaze.last == TimedGaze(Gaze(), 0.0)
    reported = gaze.at(2.0)
    assert gaze.last == reported == TimedGaze(HERE, 1.0)


def test_only_the_prompt_mouse_changes_with_its_movements_alone():
    trace = GazeTrace((0.0, 1.0), (HERE, THERE))
    assert not GazeInput(0.0, None).changes_by_itself
    assert GazeInput(0.01, None).changes_by_itself
    assert GazeInput(0.0, trace).changes_by_itself
