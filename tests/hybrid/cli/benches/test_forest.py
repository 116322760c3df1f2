"""`hybrid bench forest`."""

from __future__ import annotations

import json

import pytest

from hybrid.cli.benches.forest import forest as command
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_a_forest_is_built_loaded_and_rendered(monkeypatch, tmp_path, capsys):
    out = tmp_path / "f.json"
    assert run(monkeypatch, "bench", command.__name__, "--nodes", 3000, "--json", out) == 0
    row = json.loads(out.read_text())
    assert row["layers"][-1] == 3000
    assert row["layers"] == sorted(row["layers"])
    assert row["nodes_drawn"] > 0
    assert row["build_s"] > 0
    assert row["load_s"] > 0
    assert row["peak_bytes"] > 1e8
    assert row["machine"]["cores"] > 0
    shown = capsys.readouterr().out
    assert f"layers of {', '.join(f'{count:,}' for count in row['layers'])} nodes" in shown
    assert f"{row['peak_bytes'] / 1e9:.2f} GB" in shown
