"""The table of extremes: tests at the ends of what users may ask for, with what each expected and got.

A test joins the table by its mark, in the room whose code it tries, and says what it got:

    @extreme("needle at 45 degrees", given="deviations of 4,000 and 0.004 px", expected="extent within 1 %")
    def test_a_needle_keeps_its_extent(each_arrays, got):
        assert got(extent / exact, ".4f") == pytest.approx(1, abs=0.01)

The cases of a parametrized test may be rows of their own: `pytest.param(..., marks=extreme(...))`.
`python -m pytest -m extremes --extremes-json FILE` runs the table alone and writes its rows, and
`python -m tests.extremes FILE` prints them in Markdown.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

MARK = "extremes"
_OPTION = "--extremes-json"
_Value = TypeVar("_Value")
_got = pytest.StashKey[list[str]]()


def extreme(name: str, *, given: str, expected: str) -> pytest.MarkDecorator:
    """Marks a test as a row of the table.

    Args:
        name: of the row, unique.
        given: the extreme input, in words.
        expected: a value, a bound or a refusal, in words.
    """
    return getattr(pytest.mark, MARK)(name=name, given=given, expected=expected)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(_OPTION, metavar="FILE", help="write the outcomes of the table of extremes as JSON")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", f"{MARK}(name, given, expected): a row of the table of extremes")
    path = config.getoption(_OPTION)
    # Processes that run tests for another one send it their reports.
    if path and not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Table(Path(path)))


@pytest.fixture
def got(request: pytest.FixtureRequest) -> Callable[..., _Value]:
    """Notes what a row of the table got and returns it: `got(value, format="")`; several notes are joined."""
    notes = request.node.stash[_got] = []

    def note(value: _Value, format_spec: str = "") -> _Value:
        notes.append(format(value, format_spec) if format_spec else str(value))
        return value

    return note


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]):
    report = yield
    mark = item.get_closest_marker(MARK)
    if mark is None or report.skipped or (report.passed and call.when != "call"):
        return report
    notes = ", ".join(item.stash.get(_got, []))
    if report.passed and not notes:
        report.outcome, report.longrepr = "failed", f"{item.nodeid}: a row of the table must say what it got"
    row = {
        "name": mark.kwargs["name"],
        "input": mark.kwargs["given"],
        "expected": mark.kwargs["expected"],
        "got": notes or str(getattr(report.longrepr, "reprcrash", report.longrepr)).splitlines()[0],
        "backend": _backend(item),
        "passed": report.passed,
    }
    report.user_properties.append((MARK, row))
    return report


def _backend(item: pytest.Item) -> str:
    """The backend that a row ran on: that of its array types, else that of the path tracer."""
    values = getattr(item, "funcargs", {})
    for name in ("each_arrays", "arrays"):
        if name in values:
            return str(values[name].backend)
    if "backend" in values:
        return str(values["backend"].variant).split("_")[0]
    return "none"


class _Table:
    """Collects the rows from the reports, and writes them to a file in the end."""

    def __init__(self, path: Path):
        self._path, self._rows = path, []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._rows += [row for name, row in report.user_properties if name == MARK]

    def pytest_sessionfinish(self) -> None:
        rows = sorted(self._rows, key=lambda row: (row["name"], row["backend"]))
        self._path.write_text(json.dumps(rows, indent=1) + "\n")


def page(rows: list[dict[str, object]]) -> str:
    """The table in Markdown."""
    lines = ["| row | input | expected | got | backend | passed |", "|---|---|---|---|---|---|"]
    for row in rows:
        cells = [
            str(row[name]).replace("|", "\\|") for name in ("name", "input", "expected", "got", "backend")
        ]
        lines.append(f"| {' | '.join(cells)} | {'yes' if row['passed'] else '**no**'} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(page(json.loads(Path(sys.argv[1]).read_text())))
