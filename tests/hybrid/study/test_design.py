"""Orders that are balanced and random, and files that say what is wrong with them."""

import json
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import pytest

from compose.base.errors import UserError
from hybrid.study.design import StudyMethod, load_design, williams
from tests.hybrid.study.studies import CONDITIONS, design

METHODS = list(StudyMethod)


@pytest.mark.parametrize("count", range(2, 9))
def test_each_condition_stands_at_each_place_and_follows_each_other_one_as_often(count):
    rows = williams(count)
    for place in range(count):
        assert set(Counter(row[place] for row in rows).values()) == {len(rows) // count}
    follows = Counter(pair for row in rows for pair in pairwise(row))
    assert len(follows) == count * (count - 1)
    assert len(set(follows.values())) == 1


@pytest.mark.parametrize("method", METHODS)
def test_an_observer_judges_everything_as_often_as_planned(method):
    made = design(method, repeats=3)
    votes = [trial.comparison for trial in made.order(4) if trial.kind == "vote"]
    assert Counter(votes) == dict.fromkeys(made.comparisons, 3)


@pytest.mark.parametrize("method", METHODS)
def test_the_order_is_that_of_the_seed_and_of_the_observer(method):
    made = design(method, scenes=4, repeats=2)
    assert made.order(1) == made.order(1)
    assert made.order(1) != made.order(2)
    assert made.order(1) != replace(made, seed=1).order(1)


def test_over_two_observers_each_pair_is_shown_in_either_order_as_often():
    made = design(StudyMethod.PAIRS, repeats=1)
    seen = Counter(
        (one.comparison, one.swapped) for n in range(2) for one in made.order(n) if one.kind == "vote"
    )
    assert seen == {(one, swapped): 1 for one in made.comparisons for swapped in (False, True)}


def test_no_scene_follows_itself_where_that_is_possible():
    made = design(StudyMethod.DSIS, scenes=5, repeats=3, attention=0)
    for observer in range(10):
        votes = [trial.comparison.scene for trial in made.order(observer) if trial.kind == "vote"]
        assert all(one != other for one, other in pairwise(votes))


def test_graded_scenes_come_one_by_one_each_after_its_benchmark():
    made = design(StudyMethod.GRADED, scenes=3, attention=0)
    votes = [trial for trial in made.order(0) if trial.kind == "vote"]
    for start in range(0, len(votes), len(CONDITIONS)):
        block = votes[start : start + len(CONDITIONS)]
        assert len({trial.comparison.scene for trial in block}) == 1
        assert [trial.benchmark is not None for trial in block] == [True, False, False]
        assert made.phases(block[0])[1]["label"] == "Benchmark"
        assert len(made.phases(block[0])) == len(made.phases(block[1])) + 2


def test_attention_is_checked_among_the_votes_and_training_comes_first():
    kinds = [trial.kind for trial in design(attention=2).order(0)]
    assert kinds[:3] == ["training"] * 3
    assert kinds[3:].count("attention") == 2
    assert kinds[3] == kinds[-1] == "vote"


def test_phases_are_those_of_bt_500():
    made = design()
    trial = next(trial for trial in made.order(0) if trial.kind == "vote")
    phases = made.phases(trial)
    assert [one["kind"] for one in phases] == ["fixation", "clip", "blank", "clip"]
    assert [one["seconds"] for one in phases] == [0.05, 0.1, 0.05, 0.1]
    assert [one["clip"] for one in phases[1::2]] == list(trial.comparison.clips)


def test_a_video_is_shown_whole():
    made = design(frames=9)
    assert made.phases(made.order(0)[0])[1]["seconds"] == 9 / 30


@pytest.mark.parametrize("method", METHODS)
def test_a_design_is_read_as_it_was_written(tmp_path, method):
    made = design(method, repeats=2, fields=({"name": "age", "label": "Age", "type": "number"},))
    moving = replace(made.clips[0], frames=2, marker=((0.1, 0.2), (0.3, 0.4)))
    made = replace(made, clips=(moving, *made.clips[1:]))
    made.save(tmp_path)
    assert load_design(tmp_path) == made


def test_a_design_that_could_not_be_read_again_is_not_written(tmp_path):
    with pytest.raises(UserError, match="consent"):
        design(consent="a" * 100_000).save(tmp_path)
    assert not list(tmp_path.iterdir())


def _changed(tmp_path, change):
    design().save(tmp_path)
    file = tmp_path / "study.json"
    found = json.loads(file.read_text())
    change(found)
    file.write_text(json.dumps(found))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.update(method="acr"), "method must be one of"),
        (lambda d: d.pop("clips"), "clips"),
        (lambda d: d.update(colour="red"), "colour"),
        (lambda d: d.update(version=2), "version"),
        (lambda d: d["clips"][0].update(name="../../etc"), "name"),
        (lambda d: d["comparisons"][0].update(clips=["nothing", "nowhere"]), "no clip no"),
        (lambda d: d["comparisons"][0].update(clips=["s0-hybrid"]), "must have 2 clips"),
        (lambda d: d["timing"].update(stimulus=0), "stimulus"),
        (lambda d: d["timing"].update(gap=1e9), "gap"),
        (lambda d: d.update(observers=0), "observers"),
        (lambda d: d.update(repeats=10**9), "repeats"),
        (lambda d: d["clips"].append(d["clips"][0]), "same name"),
        (lambda d: d["clips"][0].update(marker=[[0.5, 0.5]] * 2), "one marker"),
        (lambda d: d["attention"][0].update(expected=[7]), "expected"),
    ],
)
def test_a_damaged_design_is_one_line(tmp_path, change, said):
    _changed(tmp_path, change)
    with pytest.raises(UserError, match=said) as raised:
        load_design(tmp_path)
    assert str(tmp_path) in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"[]", b'{"format": ' + b"[" * 5000, b"null"])
def test_what_is_no_design_is_one_line(tmp_path, content):
    (tmp_path / "study.json").write_bytes(content)
    with pytest.raises(UserError, match=r"study\.json") as raised:
        load_design(tmp_path)
    assert "\n" not in str(raised.value)


def test_a_folder_without_a_study_says_how_to_make_one(tmp_path):
    with pytest.raises(UserError, match="hybrid study design"):
        load_design(tmp_path)
