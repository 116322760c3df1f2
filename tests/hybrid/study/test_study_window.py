"""Whole studies in a window in memory."""

import csv

import pytest

from compose.base.errors import UserError
from hybrid.study.session import StudySession
from tests.hybrid.study.studies import SIZE, design, write_clips


@pytest.fixture
def acting(application):
    """Runs a session in a window, in which `act` is called every few milliseconds with the page it shows."""
    from PySide6.QtCore import QTimer

    from hybrid.study.study_window import StudyWindow, run_study_window

    def run(session, act):
        def step():
            for window in application.topLevelWidgets():
                if isinstance(window, StudyWindow) and window.isVisible():
                    act(window)

        timer = QTimer()
        timer.timeout.connect(step)
        timer.start(5)
        try:
            run_study_window(session)
        finally:
            timer.stop()

    return run


def press(window, key: str) -> None:
    from PySide6.QtTest import QTest

    QTest.keyClicks(window.page, key)


def phase_of(window):
    """The phase of a trial that is shown now."""
    return getattr(window.page, "phase", None)


def answering(key="4"):
    """Presses a key at each question, and the button of each page."""

    def act(window):
        if window.question_is_shown:
            press(window, key)
        elif window.button is not None and window.button.isEnabled():
            window.button.click()

    return act


def rows(session):
    with session.file.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("frames", [1, 6])
def test_a_whole_study_of_five_pairs(acting, tmp_path, frames):
    made = design(scenes=5, conditions=("reference", "hybrid"), frames=frames, attention=0)
    write_clips(tmp_path, made)
    session = StudySession(tmp_path, made, 1)
    acting(session, answering())
    assert session.done
    votes = [row for row in rows(session) if row["kind"] == "vote"]
    assert sorted(row["scene"] for row in votes) == [f"scene {n}" for n in range(5)]
    assert {row["vote"] for row in votes} == {"4"}
    for row in rows(session):
        times = [tuple(map(float, one.split(":"))) for one in row["phases"].split()]
        assert len(times) == 4
        # However slow the machine: no phase is shorter than asked for by more than half an interval.
        assert all(shown > asked - 1000 / 60 for asked, shown in times)


def test_pictures_are_those_of_the_clips_with_a_cross(acting, tmp_path):
    made = design(scenes=1, attention=0, background=(0, 0, 40))
    write_clips(tmp_path, made)
    seen = {}
    session = StudySession(tmp_path, made, 1)

    def act(window):
        phase = phase_of(window)
        if phase is not None and phase["clip"] and phase["clip"] not in seen:
            image = window.grab().toImage()
            ratio, middle = image.devicePixelRatio(), image.rect().center()
            off = int(SIZE[0] / 2 * ratio) - 3
            seen[phase["clip"]] = [image.pixelColor(middle).getRgb()[:3]] + [
                image.pixelColor(middle.x() + dx, middle.y() + 8).getRgb()[:3] for dx in (off, off + 9)
            ]
        answering()(window)

    acting(session, act)
    for number, clip in enumerate(made.clips):
        if clip.name in seen:
            cross, inside, outside = seen[clip.name]
            assert cross == (255, 255, 255)
            assert inside == (10 * number,) * 3
            assert outside == (0, 0, 40)
    assert len(seen) >= 3


def test_closed_in_the_middle_it_resumes(acting, tmp_path):
    made = design(scenes=3, attention=0)
    write_clips(tmp_path, made)
    session = StudySession(tmp_path, made, 1)
    answer = answering("2")

    def until_four(window):
        if session.step["kind"] == "trial" and len(rows(session)) == 4:
            window.close()
        else:
            answer(window)

    acting(session, until_four)
    assert not session.done
    session.close()
    again = StudySession(tmp_path, made, 1)
    acting(again, answering("3"))
    order = [trial.comparison.scene for trial in made.order(0)]
    assert [row["scene"] for row in rows(again) if row["attempt"] == "1"] == order
    assert [row["vote"] for row in rows(again)][:5] == ["2"] * 4 + ["3"]


def test_the_time_to_answer_runs_out(acting, tmp_path):
    made = design(scenes=1, conditions=("reference", "hybrid"), attention=0)
    from dataclasses import replace

    made = replace(made, timing=replace(made.timing, answer=0.05))
    write_clips(tmp_path, made)
    session = StudySession(tmp_path, made, 1)

    def act(window):
        if window.button is not None:
            window.button.click()

    acting(session, act)
    assert {row["problem"] for row in rows(session)} == {"no answer"}
    assert {row["vote"] for row in rows(session)} == {""}


def test_a_form_is_filled_in(acting, tmp_path):
    made = design(scenes=1, attention=0, fields=({"name": "q1", "label": "Age", "type": "text"},))
    write_clips(tmp_path, made)
    session = StudySession(tmp_path, made, 1)

    def act(window):
        from PySide6.QtWidgets import QLineEdit

        for entry in window.findChildren(QLineEdit):
            entry.setText("31")
        answering()(window)

    acting(session, act)
    assert session.file.with_suffix(".json").read_text().split() == ["{", '"q1":', '"31"', "}"]


def test_the_pointer_is_the_gaze_where_the_design_says_so(acting, tmp_path):
    from PySide6.QtCore import QCoreApplication, QEvent, QPointF, Qt
    from PySide6.QtGui import QMouseEvent

    made = design(scenes=1, attention=0, gaze="mouse", pixels_per_degree=2.0, tolerance=2.0)
    write_clips(tmp_path, made)
    session = StudySession(tmp_path, made, 1)
    answer = answering()

    def act(window):
        if phase_of(window) is not None:
            none, corner = Qt.MouseButton.NoButton, QPointF(5, 5)
            keys = Qt.KeyboardModifier.NoModifier
            event = QMouseEvent(QEvent.Type.MouseMove, corner, corner, none, none, keys)
            QCoreApplication.sendEvent(window.page, event)
        answer(window)

    acting(session, act)
    problems = {row["problem"] for row in rows(session)}
    assert "looked away" in problems


def test_a_missing_frame_ends_with_one_line(acting, tmp_path):
    made = design(scenes=1, attention=0)
    session = StudySession(tmp_path, made, 1)
    with pytest.raises(UserError, match=r"000000\.png: is missing"):
        acting(session, answering())
