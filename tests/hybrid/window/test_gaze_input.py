"""The gaze from the mouse or a trace, with and without latency, and its recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from compose.base.errors import UserError
from compose.eye.gaze import Gaze, GazeTrace, load_gaze_trace
from hybrid.window.gaze_input import GazeInput, GazeRecording, TimedGaze, unused_file

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


def test_the_lowest_free_number_is_taken(tmp_path):
    assert unused_file(tmp_path, "room", ".png") == tmp_path / "room-001.png"
    (tmp_path / "room-001.png").touch()
    assert unused_file(tmp_path, "room", ".png") == tmp_path / "room-002.png"
    for number in (2, 4):
        (tmp_path / f"room-00{number}.png").touch()
    assert unused_file(tmp_path, "room", ".png") == tmp_path / "room-003.png"
    assert unused_file(tmp_path, "room", ".csv") == tmp_path / "room-001.csv"
    assert unused_file(tmp_path, "box", ".png") == tmp_path / "box-001.png"


def test_a_folder_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    def fails(self: Path) -> bool:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "exists", fails)
    with pytest.raises(UserError, match=r"cannot be read \(Permission denied\)") as raised:
        unused_file(tmp_path, "room", ".png")
    assert str(raised.value).startswith(str(tmp_path))


HERE, THERE = Gaze(0.1, 0.2), Gaze(0.7, 0.8)


def test_the_file_holds_each_change_since_the_recording_began(tmp_path):
    recording = GazeRecording(tmp_path)
    recording.add(1.0, THERE)
    assert recording.toggle("room") == "recording the gaze"
    for now, gaze in ((3.0, HERE), (3.1, HERE), (3.5, THERE), (4.0, THERE), (4.5, HERE)):
        recording.add(now, gaze)
    assert recording.toggle("room") == str(tmp_path / "room-gaze-001.csv")
    file = tmp_path / "room-gaze-001.csv"
    assert load_gaze_trace(file) == GazeTrace((0.0, 0.5, 1.5), (HERE, THERE, HERE))
    assert file.read_text().splitlines()[1].startswith("0.0000,")


def test_each_recording_begins_anew_and_has_its_own_file(tmp_path):
    recording = GazeRecording(tmp_path)
    for number, gaze in enumerate((HERE, THERE)):
        recording.toggle("room")
        recording.add(10.0 * number, gaze)
        recording.toggle("room")
        recording.add(10.0 * number + 1, Gaze())
    assert load_gaze_trace(tmp_path / "room-gaze-001.csv") == GazeTrace((0.0,), (HERE,))
    assert load_gaze_trace(tmp_path / "room-gaze-002.csv") == GazeTrace((0.0,), (THERE,))


def test_nothing_is_written_if_nothing_was_recorded(tmp_path):
    recording = GazeRecording(tmp_path)
    recording.toggle("room")
    assert recording.toggle("room") == "no gaze was recorded"
    assert not list(tmp_path.iterdir())
    assert recording.toggle("room") == "recording the gaze"


def test_a_recording_that_cannot_be_written_continues(tmp_path):
    folder = tmp_path / "folder"
    folder.write_text("in the way")
    recording = GazeRecording(folder)
    recording.toggle("room")
    recording.add(1.0, HERE)
    assert "cannot be" in recording.toggle("room")
    recording.add(2.0, THERE)
    folder.unlink()
    recording.toggle("room")
    written = load_gaze_trace(folder / "room-gaze-001.csv")
    assert written.seconds == pytest.approx((0.0, 1.0))
