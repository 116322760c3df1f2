"""`hybrid bench moving`."""

from __future__ import annotations

import json

import pytest

from hybrid.bench import moving as module
from hybrid.cli.benches.moving import moving as command
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import save_forest
from tests.hybrid.command import run
from tests.hybrid.forests import rough_forest

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_each_method_has_a_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(module, "_CLIPS", 1)
    save_forest(tmp_path / "f", rough_forest(load_scene("room-moving")))
    out = tmp_path / "rows.json"
    common = ["bench", command.__name__, "room-moving", "--forest", tmp_path / "f", "--size", 48, 32]
    assert run(monkeypatch, *common, "--reference-spp", 8, "--json", out) == 0
    methods = list(dict.fromkeys(row["method"] for row in json.loads(out.read_text())["rows"]))
    assert len(methods) == 4
    shown = capsys.readouterr().out.splitlines()
    assert [line[:23].strip() for line in shown[-4:]] == methods
    assert shown[-5].split()[:3] == ["method", "whole", "foveal"]
