"""Adds a page to the documentation site for each public name of `hybrid` and `splat`."""

from __future__ import annotations

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

import hybrid
import splat

NAMES = [f"{package.__name__}.{name}" for package in (hybrid, splat) for name in package.__all__]


def on_config(config: MkDocsConfig) -> None:
    """Appends the pages to the navigation."""
    assert config.nav is not None
    config.nav.append({"API": [{name: f"api/{name}.md"} for name in NAMES]})


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Makes the pages."""
    for name in NAMES:
        files.append(File.generated(config, f"api/{name}.md", content=f"::: {name}\n"))
