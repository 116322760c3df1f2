"""The documentation agrees with the code: the reference names every option, links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer

from hybrid.cli.main import app

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def commands() -> dict[str, list[str]]:
    """Long options by command, `bench raster` for example."""
    root = typer.main.get_command(app)
    found = {}
    for name, command in root.commands.items():
        inner = getattr(command, "commands", None) or {"": command}
        for sub, leaf in inner.items():
            options = [option for parameter in leaf.params for option in parameter.opts]
            found[f"{name} {sub}".strip()] = [option for option in options if option.startswith("--")]
    return found


@pytest.mark.parametrize("command", commands())
def test_the_reference_names_every_option(command):
    text = (ROOT / "docs" / "commands.md").read_text()
    section = re.search(rf"(?ms)^#+ `hybrid {command}`$(.*?)(?=^#+ `|\Z)", text)
    assert section is not None, f"hybrid {command} is missing from docs/commands.md; see CONTRIBUTING.md"
    missing = [
        option
        for option in commands()[command]
        if f"`{option}" not in section[1] and option not in section[1]
    ]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_files_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text())
    local = [target for target in targets if "://" not in target]
    assert [target for target in local if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_use_options_that_exist(page):
    known = {option for options in commands().values() for option in options} | {"--help"}
    lines = [line for line in page.read_text().splitlines() if re.search(r"hybrid (\w+)", line)]
    used = {
        option
        for line in lines
        for command in re.findall(r"`?(hybrid [^`|]*)", line)
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", command)
    }
    assert used - known == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_source_files_that_pages_name_exist(page):
    named = re.findall(
        r"`((?:compose|pathtrace|splat|hybrid|tests|examples|scenes)/[\w/.]*)`", page.read_text()
    )
    assert [path for path in named if not (ROOT / path).exists()] == []
