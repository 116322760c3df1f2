"""`hybrid demo`: what reaches the window; the window itself is tested in its own room."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from compose.eye.gaze import Gaze, GazeTrace, simulated
from hybrid.cli import demo as command
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from tests.hybrid.command import run

pytest.importorskip("PySide6", reason="the window requires PySide6")
from hybrid.window import application as module
from hybrid.window import qt_check as qt


@pytest.fixture
def given(monkeypatch):
    """What the window is given; none is opened."""
    notes = []

    def noting(*arguments):
        notes.append(arguments)
        return {"frames": 3}, "3 frames"

    monkeypatch.setattr(qt, "require_window", lambda: None)
    monkeypatch.setattr(module, "run_window", noting)
    return notes


def test_every_option_reaches_the_window(given, monkeypatch, tmp_path, capsys):
    trace = GazeTrace((0.0, 0.5), (Gaze(0.25, 0.5), Gaze(0.75, 0.5)))
    trace.save(tmp_path / "gaze.csv")
    options = ["--forest", tmp_path / "f", "--size", 100, 80, "--fov-a", 30, "--fov-b", 10, "--spp", 2]
    options += ["--acuity-model", "fov-gs", "--target", 15, "--gaze-trace", tmp_path / "gaze.csv"]
    options += ["--latency", 50, "--out", tmp_path, "--bench", 9, "--load", 4, "--display", "hmd"]
    options += [
        "--play",
        "--thin-glass",
        "--sensor",
        "door",
        "--backend",
        "llvm",
        "--json",
        tmp_path / "d.json",
    ]
    assert run(monkeypatch, "demo", "room", *options) == 0
    settings = FrameSettings(fov_a=30, fov_b=10, spp=2, acuity_model="fov-gs", display="hmd")
    window = module.WindowOptions((100, 80), 0.05, tmp_path, 15.0, 9.0, 4.0, True)
    assert given == [("room", tmp_path / "f", "llvm", settings, trace, window, True, "door")]
    assert json.loads((tmp_path / "d.json").read_text()) == {"frames": 3}
    assert capsys.readouterr().out == "3 frames\n"


def test_without_options_the_mouse_is_the_gaze(given, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, command.demo.__name__, "room") == 0
    window = module.WindowOptions((640, 480), 0.0, Path("."), None, None, 0.0)
    assert given == [("room", None, "auto", INTERACTIVE, None, window, False, None)]
    assert capsys.readouterr().out == ""


def test_a_simulated_viewer_is_one_of_the_display_window_and_seed(given, monkeypatch, tmp_path):
    options = ["--simulate", "--seed", 7, "--size", 100, 80, "--display", "hmd", "--out", tmp_path]
    assert run(monkeypatch, "demo", "room", *options) == 0
    ((_, _, _, settings, trace, *_),) = given
    assert trace == simulated(settings.display, 100, 80, 60.0, 7)
