"""`hybrid bench moving`."""

from __future__ import annotations

import json

import pytest

from hybrid.bench import moving_bench as module
from hybrid.cli.bench import moving as command
from hybrid.preparation.scene_plan import planned_scene
from splat.io.forest_file import save_forest
from tests.hybrid.command import run
from tests.hybrid.forests import rough_forest

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_each_method_has_a_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(module, "_CLIPS", 1)
    save_forest(tmp_path / "f", rough_forest(planned_scene("room-moving")))
    out = tmp_path / "rows.json"
    common = ["bench", command.__name__, "room-moving", "--forest", tmp_path / "f", "--size", 48, 32]
    save_forest(tmp_path / "other.forest", rough_forest(planned_scene("room-moving")))
    options = ["--reference-spp", 8, "--against", tmp_path / "other.forest", "--json", out]
    assert run(monkeypatch, *common, *options) == 0
    methods = list(dict.fromkeys(row["method"] for row in json.loads(out.read_text())["rows"]))
    assert {
        "hybrid",
        "splats alone",
        "path-traced, denoised",
        "other",
        "other, fov-gs",
        "other, stelacsf",
    } <= set(methods)
    shown = capsys.readouterr().out.splitlines()
    first = next(number for number, line in enumerate(shown) if line.startswith("method "))
    assert shown[first].split()[:3] == ["method", "whole", "foveal"]
    end = first + 1 + len(methods)
    assert [line[:23].strip() for line in shown[first + 1 : end]] == methods
    # What videos and registration say, where anything is known of them.
    assert [line.rsplit(": ", 1)[0] for line in shown[end:]] in (methods, [])
