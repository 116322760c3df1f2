"""The gaze is recorded between two presses of a key, and the file replays it."""

from __future__ import annotations

import pytest

from compose.eye.gaze import Gaze, GazeTrace, load_gaze_trace
from hybrid.window.gaze_input import GazeRecording

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
