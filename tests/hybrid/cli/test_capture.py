"""`hybrid capture`."""

from __future__ import annotations

import json

import pytest

from hybrid.cli import capture as command
from hybrid.preparation.scene_plan import as_planned
from pathtrace.dataset import capture as module
from pathtrace.dataset.frame_set import CaptureSettings, read_frame_set
from pathtrace.scene.scene import load_scene
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_a_frame_set_is_written_and_described(monkeypatch, tmp_path, capsys):
    out = tmp_path / "c.json"
    options = ["--views", 2, "--held-out", 1, "--size", 20, 16, "--spp", 2, "--held-out-spp", 4]
    common = ["capture", "cornell", tmp_path / "frames"]
    assert run(monkeypatch, *common, *options, "--json", out, "--max-depth", 3) == 0
    frames = read_frame_set(tmp_path / "frames")
    assert (len(frames.training), len(frames.held_out)) == (2, 1)
    row = json.loads(out.read_text())
    assert row.pop("seconds") > 0
    assert row == {"scene": "cornell", "views": 2, "held_out": 1, "width": 20, "height": 16, "spp": 2} | {
        "integrator": "cached"
    }
    assert f"2 training views and 1 held-out views in {tmp_path / 'frames'}" in capsys.readouterr().out


def test_every_option_reaches_the_settings(monkeypatch, tmp_path):
    given = []

    def capture(scene, folder, settings, progress, cache):
        given.extend([scene.max_depth, folder, settings, cache])
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "capture", capture)
    options = ["--views", 3, "--held-out", 2, "--size", 40, 30, "--spp", 5, "--held-out-spp", 6, "--seed", 7]
    options += ["--max-depth", 2, "--integrator", "path", "--fov", 90]
    assert run(monkeypatch, "capture", "cornell", tmp_path / "f", *options) != 0
    assert given == [2, tmp_path / "f", CaptureSettings(3, 2, 40, 30, 5, 6, seed=7, fov=90), None]


def test_the_defaults_are_those_of_the_settings(monkeypatch, tmp_path):
    given = []

    def capture(scene, folder, settings, progress, cache):
        given.extend([settings, cache is not None])
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "capture", capture)
    assert run(monkeypatch, command.capture.__name__, "cornell", tmp_path / "f") != 0
    planned = as_planned(load_scene("cornell")).plan["samples"]
    assert given == [CaptureSettings(spp=planned), True]


def test_an_unknown_integrator_is_refused(monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "capture", "cornell", tmp_path / "f", "--integrator", "mlt") == 2
    assert "integrator mlt: must be path or cached" in capsys.readouterr().err
    assert not (tmp_path / "f").exists()
