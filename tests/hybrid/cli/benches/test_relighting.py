"""`hybrid bench relighting`."""

from __future__ import annotations

import json

import pytest

from hybrid.cli.benches.relighting import relighting as command
from tests.hybrid.command import run

SKY = """<scene version="3.0.0">
    <sensor type="perspective"><film type="hdrfilm"/></sensor>
    <emitter type="constant"/>
</scene>"""

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_a_cache_follows_a_dimmed_lamp(monkeypatch, tmp_path, capsys):
    out = tmp_path / "r.json"
    options = ["--size", 32, 32, "--reference-spp", 64, "--max-depth", 3, "--json", out]
    assert run(monkeypatch, "bench", command.__name__, "cornell", *options) == 0
    found = json.loads(out.read_text())
    states = ["stale", "1 updates", "4 updates", "8 updates", "12 updates", "fresh 1", "fresh 2", "fresh 3"]
    assert [row["cache"] for row in found["rows"]] == states
    assert found["scene"] == "cornell"
    assert found["machine"]
    shown = capsys.readouterr().out.splitlines()
    assert "per update" in shown[0]
    assert [line[:14].strip() for line in shown[2:]] == states


def test_without_a_surface_there_is_nothing_to_follow(monkeypatch, tmp_path, capsys):
    scene, out = tmp_path / "sky.xml", tmp_path / "r.json"
    scene.write_text(SKY)
    assert run(monkeypatch, "bench", command.__name__, scene, "--size", 8, 8, "--json", out) == 0
    assert "nothing to follow" in capsys.readouterr().out
    assert json.loads(out.read_text())["rows"] == []
