"""`hybrid plan`."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from hybrid.preparation.scene_plan import as_stored
from pathtrace.scene.scene import load_scene
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_a_plan_is_shown_stored_and_drawn(monkeypatch, tmp_path, capsys):
    options = ["--json", tmp_path / "plan.json", "--picture", tmp_path / "plan.png", "--set", "degree=1"]
    assert run(monkeypatch, "plan", "cornell", "--size", 512, 512, *options) == 0
    rows = {row["name"]: row for row in json.loads((tmp_path / "plan.json").read_text())["decisions"]}
    assert set(rows["path depth"]) == {"name", "value", "fixed", "evidence", "gain", "of"}
    assert rows["degree"]["value"] == 1
    assert rows["path depth"]["evidence"]["beyond"] < 0.005
    shown = capsys.readouterr().out
    assert all(name in shown for name in rows)
    # Three images, a diagram and a table are no empty page.
    assert np.std(Image.open(tmp_path / "plan.png").convert("L")) > 20
    scene = as_stored(load_scene("cornell"))
    assert scene.plan["degree"] == 1
    assert scene.max_depth == rows["path depth"]["value"]


def test_mistakes_are_named_before_the_scene_is_looked_at(monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "plan", "cornell", "--set", "motion=still") == 2
    assert "--set motion=still: must be one of" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert run(monkeypatch, "plan", "cornell", "--picture", tmp_path / "file" / "p.png") == 2
    assert "file" in capsys.readouterr().err
    assert as_stored(load_scene("cornell")).plan == {}


def test_other_commands_override_it_too(monkeypatch, tmp_path, capsys):
    frames = tmp_path / "frames"
    for command in (["prepare", "cornell"], ["capture", "cornell", frames], ["quickstart", "cornell"]):
        assert run(monkeypatch, *command, "--set", "degree=9") == 2
        assert "--set degree=9: must be a whole number from 0 to 3" in capsys.readouterr().err
    given = ["--views", 1, "--held-out", 1, "--size", 16, 16, "--held-out-spp", 2, "--set", "samples=2"]
    assert run(monkeypatch, "capture", "cornell", frames, *given) == 0
    assert json.loads((frames / "transforms.json").read_text())["settings"]["spp"] == 2
