"""`hybrid bench integrator`."""

from __future__ import annotations

import json

import pytest

from hybrid.cli.bench import integrator as command
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_both_integrators_are_compared(monkeypatch, tmp_path, capsys):
    out = tmp_path / "i.json"
    options = ["--size", 32, 32, "--reference-spp", 64, "--repeats", 3, "--max-depth", 3, "--json", out]
    assert run(monkeypatch, "bench", command.__name__, "cornell", *options) == 0
    found = json.loads(out.read_text())
    rows = [[one, str(spp)] for spp in (1, 4, 64, 256) for one in ("path", "cached")]
    assert [[row["integrator"], str(row["spp"])] for row in found["rows"]] == rows
    assert [row["integrator"] for row in found["bias"]] == ["path", "cached"]
    assert found["scene"] == "cornell"
    assert found["machine"]
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].startswith(f"cache: {found['cache']['cells']:,} cells")
    assert "ns per look-up" in shown[1]
    assert [line.split()[:2] for line in shown[3:11]] == rows
    assert [line.split()[0] for line in shown[12:14]] == ["path", "cached"]
