"""Sessions that store every answer, repeat what failed, and resume where they ended; streams of gaze."""

import csv
import json
import time
import uuid

import pytest

from compose.base.errors import UserError
from hybrid.study.design import StudyMethod
from hybrid.study.session import COLUMNS, LabStream, StudySession, next_observer, observer_file
from tests.hybrid.study.studies import design, finish, reply, up_to_trials


def rows(folder, observer=1):
    with observer_file(folder, observer).open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("method", list(StudyMethod))
def test_all_trials_are_asked_and_stored(tmp_path, method):
    made = design(method)
    shown = finish(StudySession(tmp_path, made, 1))
    found, order = rows(tmp_path), made.order(0)
    assert [row["kind"] for row in found] == [trial.kind for trial in order]
    assert len(shown) == len(order)
    answer = "chosen" if method is StudyMethod.PAIRS else "vote"
    assert {row[answer] for row in found} == {"1"}
    assert [step["number"] for step in shown][-1] == sum(trial.kind == "vote" for trial in order)


def test_a_choice_names_what_was_shown_first(tmp_path):
    made = design(StudyMethod.PAIRS)
    shown = finish(StudySession(tmp_path, made, 1))
    for step, row in zip(shown, rows(tmp_path), strict=True):
        clips = [made.clip(phase["clip"]).condition for phase in step["phases"] if phase["clip"]]
        assert [row["first"], row["second"]] == clips


def test_consent_and_questions_come_first_and_only_they_are_stored(tmp_path):
    fields = ({"name": "age", "label": "Age", "type": "number"},)
    session = StudySession(tmp_path, design(consent="Do you?", fields=fields), 1)
    assert session.step["body"] == "Do you?"
    session.answer(reply(session))
    assert not observer_file(tmp_path, 1).read_bytes()
    with pytest.raises(UserError, match="reply"):
        session.answer(reply(session, values={"age": "old"}))
    session.answer(reply(session, values={"age": "31", "name": "Ada"}))
    assert json.loads((tmp_path / "results" / "observer-001.json").read_text()) == {"age": "31"}


@pytest.mark.parametrize("method", list(StudyMethod))
def test_a_session_that_was_killed_goes_on_in_the_same_order(tmp_path, method):
    made = design(method, scenes=3)
    whole = [step["phases"] for step in finish(StudySession(tmp_path / "whole", made, 2))]
    first = up_to_trials(StudySession(tmp_path / "cut", made, 2))
    seen = []
    for _ in range(4):
        seen.append(up_to_trials(first).step["phases"])
        first.answer(reply(first))
    # Killed: nothing is closed but by the system.
    first.close()
    second = StudySession(tmp_path / "cut", made, 2)
    assert second.step["title"] == "Welcome back"
    seen += [step["phases"] for step in finish(second)]
    assert seen == whole
    assert [row["trial"] for row in rows(tmp_path / "cut", 2)] == [str(n + 1) for n in range(len(whole))]


def test_half_a_line_of_a_crash_is_asked_again(tmp_path):
    made = design()
    session = up_to_trials(StudySession(tmp_path, made, 1))
    session.answer(reply(session))
    session.close()
    file = observer_file(tmp_path, 1)
    before = file.read_bytes()
    file.write_bytes(before + b"1,2,1,vote,sce")
    again = StudySession(tmp_path, made, 1)
    assert file.read_bytes() == before
    finish(again)
    assert len(rows(tmp_path)) == len(made.order(0))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"answer": None}, "no answer"),
        ({"dropped": 1}, "dropped frames"),
        ({"late": 2}, "late frames"),
        ({"shown_ms": 190.0}, "late phase"),
    ],
)
def test_a_trial_that_failed_is_asked_again_at_the_end_and_counts_the_third_time(tmp_path, changes, problem):
    made = design(scenes=1, attention=0)
    session = up_to_trials(StudySession(tmp_path, made, 1))
    while session.step["phases"] != made.phases(made.order(0)[3]):
        session.answer(reply(session))
        up_to_trials(session)
    wanted = session.step["phases"]

    def failed():
        good = reply(session)
        phases = [one | {k: v for k, v in changes.items() if k != "answer"} for one in good["phases"]]
        return good | {"phases": phases} | {k: v for k, v in changes.items() if k == "answer"}

    while not session.done:
        session.answer(
            failed()
            if session.step["kind"] == "trial" and session.step["phases"] == wanted
            else reply(session)
        )
    found = [row for row in rows(tmp_path) if row["trial"] == "4"]
    assert [(row["attempt"], row["kind"]) for row in found] == [
        ("1", "repeated"),
        ("2", "repeated"),
        ("3", "vote"),
    ]
    assert {row["problem"] for row in found} == {problem}


def test_who_looks_away_from_the_cross_is_asked_again(tmp_path):
    made = design(gaze="mouse", pixels_per_degree=4.0, tolerance=3.0, scenes=1, attention=0)
    session = up_to_trials(StudySession(tmp_path, made, 1))
    for _ in range(3):
        session.answer(reply(session))
        up_to_trials(session)
    # Of four phases, the clips are shown from 50 to 150 ms and from 200 to 300 ms.
    looks = [[ms, 0.5, 0.5] for ms in range(0, 300, 10)]
    session.answer(
        reply(
            session, gaze=[[ms, 0.9, 0.5] if ms < 50 or 150 <= ms < 200 else [ms, x, y] for ms, x, y in looks]
        )
    )
    up_to_trials(session)
    # 12.8 pixels are 3.2 degrees here, for a third of the time.
    session.answer(reply(session, gaze=[[ms, 0.9 if 50 <= ms < 120 else 0.5, 0.5] for ms, _, _ in looks]))
    assert [row["problem"] for row in rows(tmp_path)][3:] == ["", "looked away"]


class Silent:
    def last(self, seconds):
        return []


class Staring:
    """Looks at the cross, as an eye tracker at 100 Hz reports it."""

    def last(self, seconds):
        return [(seconds * n / 100, 0.5, 0.5) for n in range(100)]


@pytest.mark.parametrize(("stream", "problem"), [(Silent(), "no gaze"), (Staring(), "")])
def test_the_gaze_may_come_from_a_stream(tmp_path, stream, problem):
    session = up_to_trials(StudySession(tmp_path, design(gaze="stream"), 1, stream))
    session.answer(reply(session))
    assert rows(tmp_path)[0]["problem"] == problem


def test_attention_is_judged_in_the_order_that_was_shown(tmp_path):
    made = design(StudyMethod.PAIRS, scenes=3, attention=3)
    for observer in range(1, 5):
        finish(StudySession(tmp_path, made, observer))
        for row in rows(tmp_path, observer):
            if row["kind"] == "attention":
                assert row["correct"] == ("yes" if row["first"] == "reference" else "no")


def test_breaks_come_after_so_many_trials(tmp_path):
    session = StudySession(tmp_path, design(between_breaks=4, scenes=4), 1)
    trials, at = 0, []
    while not session.done:
        trials += session.step["kind"] == "trial"
        at += [trials] if session.step.get("title") == "Break" else []
        session.answer(reply(session))
    assert trials == 12
    assert at == [4, 8]


@pytest.mark.parametrize(
    "changes",
    [
        {"answer": 9},
        {"answer": "1; drop"},
        {"phases": []},
        {"phases": None},
        {"phases": [{}] * 4},
        {"reaction_ms": float("nan")},
        {"reaction_ms": -1},
        {"interval_ms": "fast"},
        {"gaze": [[1, 2]]},
        {"gaze": 7},
    ],
)
def test_a_reply_that_is_none_changes_nothing(tmp_path, changes):
    session = up_to_trials(StudySession(tmp_path, design(), 1))
    step, stored = session.step, session.file.read_bytes()
    with pytest.raises(UserError, match="reply") as raised:
        session.answer(reply(session) | changes)
    assert "\n" not in str(raised.value)
    assert session.step == step
    assert session.file.read_bytes() == stored


@pytest.mark.parametrize("found", [None, [], {"step": -1}, "next"])
def test_a_reply_to_another_step_changes_nothing(tmp_path, found):
    session = StudySession(tmp_path, design(), 1)
    step = session.step
    with pytest.raises(UserError, match="current step"):
        session.answer(found)
    assert session.step == step


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"\xff\n", "damaged"),
        (b"a,b,c\n", "not an answer"),
        (b",".join([b"1"] * len(COLUMNS)) + b"\n", "design"),
    ],
)
def test_a_damaged_file_is_one_line_and_stays_as_it_is(tmp_path, line, said):
    session = up_to_trials(StudySession(tmp_path, design(), 1))
    session.answer(reply(session))
    session.close()
    file = observer_file(tmp_path, 1)
    file.write_bytes(before := file.read_bytes() + line)
    with pytest.raises(UserError, match=said) as raised:
        StudySession(tmp_path, design(), 1)
    assert "\n" not in str(raised.value)
    assert file.read_bytes() == before


def test_answers_to_another_design_are_refused(tmp_path):
    session = StudySession(tmp_path, design(scenes=4), 1)
    finish(session)
    session.close()
    with pytest.raises(UserError, match="its design was another one"):
        StudySession(tmp_path, design(scenes=4, seed=1), 1)


class FullDisk:
    def write(self, content):
        raise OSError(28, "No space left on device")

    def close(self):
        pass


def test_a_full_disk_is_one_line_and_the_session_resumes(tmp_path):
    made = design()
    session = up_to_trials(StudySession(tmp_path, made, 1))
    session.answer(reply(session))
    session.close()
    session._rows = FullDisk()
    for said in ("No space left", "run the study again"):
        with pytest.raises(UserError, match=said):
            session.answer(reply(session))
    again = StudySession(tmp_path, made, 1)
    finish(again)
    assert [row["trial"] for row in rows(tmp_path)] == [str(n + 1) for n in range(len(made.order(0)))]


def test_an_observer_is_run_by_one_process(tmp_path):
    pytest.importorskip("fcntl")
    first = StudySession(tmp_path, design(), 1)
    with pytest.raises(UserError, match="another process"):
        StudySession(tmp_path, design(), 1)
    first.close()
    StudySession(tmp_path, design(), 1).close()


def test_the_next_observer_has_the_next_number(tmp_path):
    assert next_observer(tmp_path) == 1
    StudySession(tmp_path, design(), 7).close()
    assert next_observer(tmp_path) == 8


pylsl = pytest.importorskip("pylsl", reason="gaze streams need pylsl", exc_type=(ImportError, RuntimeError))


@pytest.fixture
def outlet():
    info = pylsl.StreamInfo("tests", "Gaze", 2, 100, pylsl.cf_float32, uuid.uuid4().hex)
    made = pylsl.StreamOutlet(info)
    if not pylsl.resolve_byprop("source_id", info.source_id(), 1, 5.0):
        pytest.skip("this machine's network carries no streams")
    return made


def test_gazes_of_the_last_seconds_are_known(outlet):
    stream = LabStream()
    deadline = time.monotonic() + 20
    # The first samples may be sent before the stream is open.
    while not stream.last(60.0) and time.monotonic() < deadline:
        outlet.push_sample([0.25, 0.75])
        time.sleep(0.01)
    ago, x, y = stream.last(60.0)[-1]
    assert (x, y) == (0.25, 0.75)
    assert 0 <= ago < 60
    assert stream.last(0.0) == []
    stream.close()


def test_without_a_stream_it_says_what_to_start():
    if pylsl.resolve_byprop("type", "Gaze", 1, 0.2):
        pytest.skip("another program streams gaze here")
    with pytest.raises(UserError, match="start the eye tracker"):
        LabStream(looked_for=0.2)
