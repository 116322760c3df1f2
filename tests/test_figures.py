"""Figures in README and docs are those of the measurements kept beside them."""

from __future__ import annotations

import re

import pytest

from benchmarks import tables
from benchmarks.measure import MEASUREMENTS


@pytest.mark.parametrize("page", tables.PAGES, ids=lambda page: page.name)
def test_tables_are_those_of_the_data(page):
    text = page.read_text()
    assert tables.filled(text) == text, "run python -m benchmarks.tables"


def test_another_measurement_changes_the_table(monkeypatch):
    text = tables.ROOT.joinpath("README.md").read_text()
    monkeypatch.setattr(tables, "result", _halved)
    assert tables.filled(text) != text


def _halved(name):
    found = tables.measured(name)["result"]
    return {**found, "registration_px": found["registration_px"] / 2} if name == "quickstart" else found


def test_every_table_is_shown_and_every_measurement_used():
    text = "".join(page.read_text() for page in tables.PAGES)
    assert set(re.findall(r"<!-- figures (\S+) -->", text)) == set(tables.TABLES)
    names = {file.stem for file in tables.DATA.glob("*.json")}
    assert {name for name in names if not name.startswith("card-")} == set(MEASUREMENTS)


def test_measurements_tell_where_and_when_they_were_made():
    for file in tables.DATA.glob("*.json"):
        found = tables.measured(file.stem)
        assert {"command", "date", "machine", "result"} <= set(found), file
        assert {"cpu", "cores", "gpu", "version", "packages"} <= set(found["machine"]), file
        assert str(tables.ROOT) not in file.read_text()


@pytest.mark.parametrize("page", tables.PAGES[1:], ids=lambda page: f"{page.parent.name}-{page.name}")
def test_figures_of_a_page_are_of_one_machine(page, monkeypatch):
    """README's, each of which is from another page, need not be."""
    machines, measured = set(), tables.measured

    def noted(name):
        machines.add(measured(name)["machine"]["cpu"])
        return measured(name)

    monkeypatch.setattr(tables, "measured", noted)
    tables.filled(page.read_text())
    assert len(machines) == 1
