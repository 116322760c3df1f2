"""The house: imports point one way, rooms are few, and the documentation draws them as they are."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("compose", "pathtrace", "splat", "hybrid")
MOST_ROOMS, MOST_ARROWS, MOST_FILES = 9, 40, 3


def test_the_direction_of_imports_holds():
    linter = Path(sys.executable).with_name("lint-imports")
    result = subprocess.run([linter, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def arrows_between_rooms() -> dict[str, set[str]]:
    """The rooms that each room of `hybrid` imports."""
    graph = grimp.build_graph("hybrid")
    rooms: dict[str, set[str]] = {}
    for module in graph.modules:
        names = module.split(".")
        if len(names) > 1:
            imported = (found.split(".") for found in graph.find_modules_directly_imported_by(module))
            rooms.setdefault(names[1], set()).update(found[1] for found in imported if len(found) > 1)
    return {room: found - {room} for room, found in rooms.items()}


def rows_below(heading: str) -> list[list[str]]:
    """Cells of the last table of a section of docs/how-it-works.md, without its head."""
    section = (ROOT / "docs" / "how-it-works.md").read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    table = section.split("|---|---|\n")[-1].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table if line.startswith("|")]


def test_the_rooms_of_hybrid_are_few_and_as_drawn():
    found = arrows_between_rooms()
    drawn = {
        room.strip("`"): set() if names == "nothing" else set(names.split(", "))
        for room, names in rows_below("Rooms")
    }
    assert found == drawn
    assert len(found) <= MOST_ROOMS
    assert sum(map(len, found.values())) <= MOST_ARROWS


def test_no_change_opens_many_files():
    rows = {
        change: re.findall(r"`([\w/]+\.py)`", files) for change, files in rows_below("Where to change what")
    }
    assert {change: files for change, files in rows.items() if len(files) > MOST_FILES} == {}


def test_a_package_has_no_loose_module_but_its_front_door():
    loose = [path for package in PACKAGES for path in (ROOT / package).glob("*.py")]
    assert {path.name for path in loose} == {"__init__.py"}
