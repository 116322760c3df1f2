"""What tests of the benches share."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.hybrid.command import run

Rows = list[dict]


@pytest.fixture
def display(tmp_path) -> Path:
    """A small display."""
    file = tmp_path / "display.json"
    file.write_text(json.dumps({"width": 192, "height": 128, "fov": 60}))
    return file


@pytest.fixture
def bench_fovea(made, monkeypatch, tmp_path) -> Callable[..., Rows]:
    """Runs a bench of the fovea on the view that nothing was fitted to; returns its rows."""

    def rows(name: str, *options: object) -> Rows:
        out = tmp_path / f"{name}.json"
        common = ["cornell", made / "frames", made / "box.forest", "--reference-spp", 4, "--json", out]
        assert run(monkeypatch, "bench", name, *common, *options) == 0
        return json.loads(out.read_text())

    return rows
