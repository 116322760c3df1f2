"""The table of extremes itself: its rows are what the tests said, and a test that says nothing fails."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.extremes import page

TESTS = """
import pytest
from tests.extremes import extreme

@extreme("good", given="1", expected="one")
def test_good(got):
    assert got(1.0, ".1f") == 1

@extreme("silent", given="2", expected="two")
def test_silent(got):
    pass

@pytest.mark.parametrize("value", [pytest.param(3, marks=extreme("bad", given="3", expected="four"))])
def test_bad(value, got):
    assert got(value) == 4

@extreme("absent", given="5", expected="five")
def test_absent(got):
    pytest.skip("not here")

def test_apart():
    pass
"""


def test_rows_are_what_tests_say(tmp_path):
    file = tmp_path / "test_rows.py"
    file.write_text(TESTS)
    table = tmp_path / "table.json"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.extremes", "--rootdir", tmp_path, file]
    project = Path(__file__).parents[1]
    run = subprocess.run(
        [*command, "-m", "extremes", "--extremes-json", table], cwd=project, capture_output=True, text=True
    )
    assert run.returncode == 1, run.stdout
    assert "2 failed, 1 passed, 1 skipped, 1 deselected" in run.stdout
    rows = {row["name"]: row for row in json.loads(table.read_text())}
    assert set(rows) == {"good", "silent", "bad"}
    assert rows["good"] == {
        "name": "good",
        "input": "1",
        "expected": "one",
        "got": "1.0",
        "backend": "none",
        "passed": True,
    }
    assert (rows["bad"]["got"], rows["bad"]["passed"]) == ("3", False)
    assert not rows["silent"]["passed"]
    assert "must say what it got" in rows["silent"]["got"]
    assert page([rows["bad"]]).splitlines()[-1] == "| bad | 3 | four | 3 | none | **no** |"
