"""Times belong to what was timed, along the whole path, and percentiles are of enough frames."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from compose.eye.gaze import Gaze
from hybrid.base.identity import Journal
from hybrid.evaluation.entries import Entry, time_rows
from hybrid.evaluation.results import OURS
from tests.hybrid.evaluation.fakes import CAMERA, VIEW, Recorder


def rows(entries: list[Entry], journal: Journal, repeats: int = 120, gaze: Gaze | None = None) -> list[dict]:
    gaze = gaze or Gaze(0.4, 0.6)
    return time_rows(entries, [VIEW], gaze, repeats, journal, lambda done, total: None)


@pytest.fixture
def journal(tmp_path) -> Journal:
    return Journal(tmp_path / "j.json", {})


def test_brief_entries_see_the_whole_path_and_have_no_99th_percentile(journal):
    whole, brief = Recorder(1), Recorder(2)
    entries = [Entry("whole", "fixed", whole), Entry("brief", "fixed", brief, briefly=True)]
    first, second = rows(entries, journal)
    assert (first["repeats"], second["repeats"]) == (120, 20)
    assert list(first["ms"]) == ["p50", "p95", "p99"]
    assert list(second["ms"]) == ["p50", "p95"]
    for seen in (whole, brief):
        x, y = (np.array([getattr(gaze, axis) for gaze in seen.gazes]) for axis in "xy")
        # The path leads around the gaze of the evaluation.
        np.testing.assert_allclose([x.min(), x.max()], [0.25, 0.55], atol=0.01)
        np.testing.assert_allclose([y.min(), y.max()], [0.45, 0.75], atol=0.01)


@pytest.mark.parametrize(
    ("repeats", "known"),
    [
        (19, ["p50"]),
        (20, ["p50", "p95"]),
        (99, ["p50", "p95"]),
        (100, ["p50", "p95", "p99"]),
    ],
)
def test_a_percentile_needs_enough_frames(journal, repeats, known):
    assert list(rows([Entry("one", "fixed", Recorder(1))], journal, repeats)[0]["ms"]) == known


def test_the_path_stays_in_the_frame(journal):
    seen = Recorder(1)
    rows([Entry("one", "fixed", seen)], journal, gaze=Gaze(0.05, 1.0))
    assert {min(gaze.x for gaze in seen.gazes), max(gaze.y for gaze in seen.gazes)} == {0.0, 1.0}


def test_rows_have_medians_of_passes_and_what_was_timed(journal):
    (row,) = rows([Entry("one", "equal-time", Recorder(7))], journal, 20)
    assert row == {
        "method": "one",
        "budget": "equal-time",
        "width": 8,
        "height": 8,
        "ms": {"p50": 7.0, "p95": 7.0},
        "passes": {"trace": 1.0},
        "repeats": 20,
    }


def test_slow_methods_end_after_80_seconds_but_not_before_20_frames(journal):
    """Frames of 2, 5 and 10 seconds: 80 seconds are over after 40 and 16; they must be exceeded."""
    seconds = (2, 5, 10)
    methods = [Recorder(1000 * time) for time in seconds]
    found = rows([Entry(f"{m.spp}", "fixed", m) for m in methods], journal, 60)
    assert [row["repeats"] for row in found] == [41, 20, 20]


def test_frames_that_warm_up_do_not_count(journal):
    seen = Recorder(1)
    rows([Entry("one", "fixed", seen)], journal, 20)
    assert len(seen.gazes) == 20 + 5


def test_no_two_frames_in_turn_have_the_same_camera(journal):
    one, other = Recorder(1), Recorder(2)
    rows([Entry("one", "fixed", one), Entry("other", "fixed", other)], journal)
    assert not {camera.key for camera in one.cameras} & {camera.key for camera in other.cameras}
    keys = [camera.key for camera in one.cameras]
    assert all(a != b for a, b in pairwise(keys))
    corner = np.array([[0.0, 0.0, 5.0]])
    moved = [camera.project(corner)[0] for camera in one.cameras]
    assert np.abs(np.array(moved) - CAMERA.project(corner)[0]).max() < 0.01


def test_times_of_another_setting_are_not_taken_over(tmp_path):
    file = tmp_path / "j.json"
    rows([Entry("full", "equal-time", Recorder(3))], Journal(file, {}), 20)
    again = Recorder(3)
    assert rows([Entry("full", "equal-time", again)], Journal(file, {}), 20)[0]["ms"]["p50"] == 3
    assert not again.gazes
    assert rows([Entry("full", "equal-time", Recorder(5))], Journal(file, {}), 20)[0]["ms"]["p50"] == 5


def test_an_interrupted_timing_resumes(tmp_path):
    """Times are saved every ten rounds."""
    file, seen = tmp_path / "j.json", Recorder(1)

    def interrupted(done: int, total: int) -> None:
        if done == 14:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        time_rows([Entry("one", "fixed", seen)], [VIEW], Gaze(), 30, Journal(file, {}), interrupted)
    rest = Recorder(1)
    assert rows([Entry("one", "fixed", rest)], Journal(file, {}), 30)[0]["repeats"] == 30
    assert len(rest.gazes) == 20 + 5


def test_frames_go_through_the_views_and_are_compared_with_ours(journal):
    """Ours take 10 ms, and the baseline 12: it is a fifth slower over the frames that both have."""
    views = [VIEW, VIEW.resized(8, 8), VIEW.resized(16, 8)]
    ours, other, brief = Recorder(10), Recorder(12), Recorder(5)
    entries = [
        Entry(OURS, "fixed", ours),
        Entry("full", "equal-time", other),
        Entry("brief", "fixed", brief, briefly=True),
    ]
    found = time_rows(entries, views, Gaze(), 60, journal, lambda done, total: None)
    assert [row["over_ours"] for row in found] == [1, pytest.approx(1.2), 0.5]
    assert [row["ms_range"] for row in found] == [[10, 10], [12, 12], [5, 5]]
    for method, count in ((ours, 60), (other, 60), (brief, 20)):
        seen = [camera.width for camera in method.cameras[5:]]
        assert seen == [8, 8, 16] * (count // 3) + [8, 8][: count % 3]
