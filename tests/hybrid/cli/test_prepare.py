"""Plans and the quickstart from the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from hybrid.cli import options
from hybrid.cli.prepare import quickstart as command
from hybrid.evaluation import quickstart as module
from hybrid.preparation.scene_plan import as_stored
from hybrid.render.frame_settings import DEFAULTS, FrameSettings
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
    for words in (["prepare", "cornell"], ["capture", "cornell", frames], ["quickstart", "cornell"]):
        assert run(monkeypatch, *words, "--set", "degree=9") == 2
        assert "--set degree=9: must be a whole number from 0 to 3" in capsys.readouterr().err
    given = ["--views", 1, "--held-out", 1, "--size", 16, 16, "--held-out-spp", 2, "--set", "samples=2"]
    assert run(monkeypatch, "capture", "cornell", frames, *given) == 0
    assert json.loads((frames / "transforms.json").read_text())["settings"]["spp"] == 2


RESULT = {
    "hybrid": {"psnr": 35.004},
    "splats_alone": {"psnr": 30.456},
    "ratio": 5.043,
    "seconds": {"total": 200.4},
}


@pytest.fixture
def given(monkeypatch):
    """What the workflow is given; scenes are not looked at."""
    notes = []
    monkeypatch.setattr(options, "planned_scene", lambda name, *_: load_scene(name))

    def quickstart(scene, folder, settings, seed, bars):
        notes.append((scene.name, folder, settings, seed))
        return RESULT

    monkeypatch.setattr(module, "quickstart", quickstart)
    return notes


def test_the_numbers_are_written_and_shown(given, monkeypatch, tmp_path, capsys):
    out, extra = tmp_path / "out", tmp_path / "extra.json"
    options = ["--fov-a", 30, "--fov-b", 10, "--seed", 4, "--json", extra]
    assert run(monkeypatch, command.__name__, "cornell", "--out", out, *options) == 0
    assert given == [("cornell", out, FrameSettings(fov_a=30, fov_b=10), 4)]
    for file in (out / "result.json", extra):
        assert json.loads(file.read_text()) == RESULT
    assert capsys.readouterr().out.splitlines() == [
        "hybrid 35.00 dB, splats 30.46 dB, 5.04 x faster than full path tracing, 200 s in total",
        f"Open {out / 'index.html'}",
    ]


def test_without_arguments_the_room_goes_into_the_folder_out(given, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "quickstart") == 0
    ((name, folder, settings, seed),) = given
    assert (name, str(folder), settings, seed) == ("room", "out", DEFAULTS, 0)
    assert (tmp_path / "out" / "result.json").is_file()
