"""`hybrid bench raster`."""

from __future__ import annotations

import json

import pytest

from hybrid.cli.bench import raster as command
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_forward_and_backward_are_timed(monkeypatch, tmp_path, capsys):
    out = tmp_path / "b.json"
    size = ["--gaussians", 500, "--size", 64, 48, "--repeats", 3]
    assert run(monkeypatch, "bench", command.__name__, *size, "--json", out) == 0
    row = json.loads(out.read_text())
    assert row["pairs"] > 500
    assert row["machine"]["cores"] > 0
    shown = capsys.readouterr().out.splitlines()
    for line, name in zip(shown, ("forward", "backward"), strict=False):
        times = row[f"{name}_ms"]
        assert 0 < times["p50"] <= times["p95"]
        assert line == f"{name}: median {times['p50']:.1f} ms, p95 {times['p95']:.1f} ms"
    assert shown[2] == f"pairs: {row['pairs']:,}"
