"""An evaluation resumes if interrupted, and its results never mix with those of another one."""

from __future__ import annotations

import json

import pytest

from compose.base.errors import UserError
from hybrid.base.identity import Journal

IDENTITY = {"scene": "a", "settings": {"size": (4, 5), "seed": 0}}


def test_a_result_is_computed_once(tmp_path):
    file = tmp_path / "work" / "journal.json"
    made = []
    make = lambda: made.append(1) or {"value": len(made)}  # noqa: E731
    for _ in range(2):
        assert Journal(file, IDENTITY).once("first", make) == {"value": 1}
    assert len(made) == 1
    journal = Journal(file, IDENTITY)
    assert "first" in journal
    assert "second" not in journal
    assert journal.once("second", make) == {"value": 2}
    assert Journal(file, IDENTITY)["second"] == {"value": 2}


def test_a_result_that_was_changed_in_place_is_saved_when_asked(tmp_path):
    file = tmp_path / "journal.json"
    journal = Journal(file, IDENTITY)
    journal.once("times", lambda: [[1.0]]).append([2.0])
    assert Journal(file, IDENTITY)["times"] == [[1.0]]
    journal.write()
    assert Journal(file, IDENTITY)["times"] == [[1.0], [2.0]]


def test_a_result_that_is_set_is_saved_at_once_and_replaces_the_one_before(tmp_path):
    journal = Journal(tmp_path / "journal.json", IDENTITY)
    journal["first"] = 1
    journal["first"] = 2
    assert Journal(tmp_path / "journal.json", IDENTITY)["first"] == 2


def test_nothing_is_written_before_the_first_result(tmp_path):
    Journal(tmp_path / "journal.json", IDENTITY)
    assert not list(tmp_path.iterdir())


def test_an_interruption_loses_only_the_result_in_progress(tmp_path):
    journal = Journal(tmp_path / "journal.json", IDENTITY)
    journal.once("first", lambda: 1)

    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        journal.once("second", interrupted)
    assert Journal(tmp_path / "journal.json", IDENTITY).once("first", lambda: 2) == 1
    assert Journal(tmp_path / "journal.json", IDENTITY).once("second", lambda: 3) == 3


def test_a_journal_that_cannot_be_written_keeps_the_results_so_far(tmp_path, monkeypatch):
    file = tmp_path / "journal.json"
    journal = Journal(file, IDENTITY)
    journal["first"] = 1
    with pytest.raises(TypeError):
        journal["second"] = object()
    assert Journal(file, IDENTITY)["first"] == 1
    assert [path.name for path in tmp_path.iterdir()] == ["journal.json"]


def test_a_complete_evaluation_leaves_no_journal(tmp_path):
    journal = Journal(tmp_path / "journal.json", IDENTITY)
    journal["first"] = 1
    journal.remove()
    assert not list(tmp_path.iterdir())
    journal.remove()


def test_another_evaluation_is_refused(tmp_path):
    file = tmp_path / "journal.json"
    Journal(file, IDENTITY).once("first", lambda: 1)
    other = {"scene": "a", "settings": {"size": (4, 6), "seed": 0}}
    message = f"^{tmp_path}: holds results for other inputs \\(settings\\); choose another folder$"
    with pytest.raises(UserError, match=message):
        Journal(file, other)
    assert json.loads(file.read_text())["results"] == {"first": 1}


@pytest.mark.parametrize(
    "content",
    ["{", "[]", "{}", '{"identity": {}}', '{"identity": 3, "results": {}}', '{"identity": {}, "results": 3}'],
)
def test_a_damaged_file_is_named(content, tmp_path):
    file = tmp_path / "journal.json"
    file.write_text(content)
    with pytest.raises(UserError, match=r"journal\.json: is damaged .*; delete it to start again"):
        Journal(file, {})
