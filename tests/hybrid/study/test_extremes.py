"""Studies at their ends: of one observer, unanimous, long, or killed at any byte."""

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.study.analysis import AnalysisSettings, analyse
from hybrid.study.comparisons import observers_for_difference
from hybrid.study.design import StudyMethod
from hybrid.study.observations import Choices, Ratings
from hybrid.study.scaling import scale
from hybrid.study.session import StudySession, observer_file
from tests.extremes import extreme
from tests.hybrid.study.studies import design, finish, reply, up_to_trials


def unanimous(observers: int, conditions: int = 2) -> Choices:
    """All prefer the condition of the lower number."""
    rows = [(f"O{n}", f"c{a:02}", f"c{a + 1:02}") for n in range(observers) for a in range(conditions - 1)]
    observer, first, second = (np.array(part) for part in zip(*rows, strict=True))
    return Choices(observer, np.full(len(rows), ""), first, second, np.full(len(rows), True))


@extreme("a study with one observer", given="choices of one", expected="refused by name")
def test_one_observer_is_refused(got):
    with pytest.raises(UserError, match="one observer only") as raised:
        scale(unanimous(1))
    got(raised.value)


@extreme("unanimous observers", given="20 of 20 choose the same", expected="a finite interval over 0")
def test_unanimous_choices_are_finite(got):
    difference = scale(unanimous(20))[0].difference(0, 1)
    assert got(difference.low, ".2f") > 0
    assert got(difference.high, ".2f") < 12


@extreme("a chain of 64 conditions", given="neighbours compared only, all unanimous", expected="in order")
def test_a_long_chain_is_scaled_in_order(got):
    found = scale(unanimous(3, 64))[0]
    assert got(bool((np.diff(found.jod) < 0).all()))
    with pytest.raises(UserError, match="64"):
        scale(unanimous(3, 65))


@extreme("votes all alike", given="5 from everybody, for everything", expected="no test fails, none differs")
def test_votes_all_alike_are_analysed(got):
    names = [(f"O{n}", condition) for n in range(5) for condition in "abc"]
    observer, condition = (np.array(part) for part in zip(*names, strict=True))
    found = analyse(Ratings(observer, np.full(15, ""), condition, np.full(15, 5.0)), AnalysisSettings())
    assert not any(row["different"] for row in found["comparison"]["pairs"])
    assert got(found["scores"][0]["mean"]) == 5


@extreme("a tiny effect", given="d_z of .001", expected="refused by name")
def test_a_tiny_effect_is_refused(got):
    with pytest.raises(UserError, match="too small") as raised:
        observers_for_difference(0.001)
    got(raised.value)


@extreme("a long study", given="4,000 trials, 3,999 of them answered", expected="resumes at the last one")
def test_a_long_study_resumes(tmp_path, got):
    made = design(StudyMethod.PAIRS, scenes=10, conditions=("reference", "a", "b", "c", "d"), repeats=40)
    assert len(made.order(0)) == 4004
    finish(StudySession(tmp_path, made, 1))
    file = observer_file(tmp_path, 1)
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(lines[:-1]))
    session = up_to_trials(StudySession(tmp_path, made, 1))
    session.answer(reply(session))
    assert got(session.done)


@extreme(
    "killed while writing", given="a file cut at each byte of its last row", expected="resumes at that trial"
)
def test_a_file_cut_anywhere_resumes_at_its_last_row(tmp_path, got):
    made = design(scenes=1, attention=0)
    finish(StudySession(tmp_path, made, 1))
    file = observer_file(tmp_path, 1)
    whole = file.read_bytes()
    last = whole[:-1].rfind(b"\n") + 1
    for end in range(last, len(whole)):
        file.write_bytes(whole[:end])
        session = StudySession(tmp_path, made, 1)
        assert not session.done
        session.close()
        assert file.read_bytes() == whole[:last]
    got(len(whole) - last)
