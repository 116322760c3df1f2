"""An evaluation goes on where it stopped, and never mixes with another."""

from __future__ import annotations

import pytest

from compose.base.errors import UserError
from hybrid.store.journal import Journal

IDENTITY = {"scene": "a", "settings": {"size": (4, 5), "seed": 0}}


def test_what_was_made_is_not_made_again(tmp_path):
    file = tmp_path / "work" / "journal.json"
    made = []
    make = lambda: made.append(1) or {"value": len(made)}  # noqa: E731
    for _ in range(2):
        assert Journal(file, IDENTITY).once("first", make) == {"value": 1}
    assert len(made) == 1
    journal = Journal(file, IDENTITY)
    journal.once("second", make)
    journal.once("times", lambda: [[1.0]]).append([2.0])
    assert Journal(file, IDENTITY).once("times", list) == [[1.0]]
    journal.write()
    assert Journal(file, IDENTITY).once("times", list) == [[1.0], [2.0]]


def test_an_interruption_loses_what_was_under_way_only(tmp_path):
    journal = Journal(tmp_path / "journal.json", IDENTITY)
    journal.once("first", lambda: 1)

    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        journal.once("second", interrupted)
    assert Journal(tmp_path / "journal.json", IDENTITY).once("first", lambda: 2) == 1
    assert Journal(tmp_path / "journal.json", IDENTITY).once("second", lambda: 3) == 3


def test_another_evaluation_or_a_damaged_file_is_refused_by_name(tmp_path):
    file = tmp_path / "journal.json"
    Journal(file, IDENTITY).once("first", lambda: 1)
    other = {"scene": "a", "settings": {"size": (4, 6), "seed": 0}}
    with pytest.raises(UserError, match="holds an evaluation with another settings"):
        Journal(file, other)
    file.write_text("{")
    with pytest.raises(UserError, match=r"journal\.json: is damaged"):
        Journal(file, IDENTITY)
