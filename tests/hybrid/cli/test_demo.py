"""`hybrid demo`: what reaches the window; the window itself is tested in its own room."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType

import pytest

from compose.eye.gaze import Gaze, GazeTrace, simulated
from hybrid.cli import demo as command
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.window import qt_check, viewer
from hybrid.window.learning import ShownScene
from hybrid.window.viewer import WindowOptions
from tests.hybrid.command import run


class Shown:
    """A window that was closed."""

    def measured(self):
        return {"frames": 3}, "3 frames"


@pytest.fixture
def given(monkeypatch):
    """What the window is given, and how it is shown; none is."""
    notes = []

    def noting(*arguments):
        notes.append(arguments)
        return Shown()

    monkeypatch.setattr(qt_check, "window_problem", lambda: None)
    monkeypatch.setattr(viewer, "viewer_of", noting)
    window = ModuleType("hybrid.window.main_window")
    window.run_window = lambda shown: notes.append("Qt")
    monkeypatch.setitem(sys.modules, "hybrid.window.main_window", window)
    monkeypatch.setattr(
        "hybrid.window.browser.serve_window", lambda shown, announce, port: notes.append(("browser", port))
    )
    return notes


def test_every_option_reaches_the_window(given, monkeypatch, tmp_path, capsys):
    trace = GazeTrace((0.0, 0.5), (Gaze(0.25, 0.5), Gaze(0.75, 0.5)))
    trace.save(tmp_path / "gaze.csv")
    options = ["--forest", tmp_path / "f", "--size", 100, 80, "--fov-a", 30, "--fov-b", 10, "--spp", 2]
    options += ["--acuity-model", "fov-gs", "--target", 15, "--gaze-trace", tmp_path / "gaze.csv"]
    options += ["--latency", 50, "--out", tmp_path, "--bench", 9, "--load", 4, "--display", "hmd"]
    options += [
        "--play",
        "--no-learning",
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
    window = WindowOptions((100, 80), 0.05, tmp_path, 15.0, 9.0, 4.0, True)
    scene = ShownScene("room", True, "door", "llvm")
    assert given == [(scene, tmp_path / "f", settings, trace, window, False), "Qt"]
    assert json.loads((tmp_path / "d.json").read_text()) == {"frames": 3}
    assert capsys.readouterr().out == "3 frames\n"


def test_without_options_the_mouse_is_the_gaze(given, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, command.demo.__name__, "room") == 0
    window = WindowOptions((640, 480), 0.0, Path("."), None, None, 0.0)
    assert given == [(ShownScene("room"), None, INTERACTIVE, None, window, True), "Qt"]
    assert capsys.readouterr().out == ""


def test_a_simulated_viewer_is_one_of_the_display_window_and_seed(given, monkeypatch, tmp_path):
    options = ["--simulate", "--seed", 7, "--size", 100, 80, "--display", "hmd", "--out", tmp_path]
    assert run(monkeypatch, "demo", "room", *options) == 0
    (_, _, settings, trace, *_), _ = given
    assert trace == simulated(settings.display, 100, 80, 60.0, 7)


@pytest.mark.parametrize(
    ("options", "problem", "port"),
    [(["--browser"], None, 0), (["--port", 8765], None, 8765), ([], "there is no display", 0)],
)
def test_a_browser_shows_it_if_asked_to_or_where_qt_cannot(
    given, monkeypatch, tmp_path, options, problem, port
):
    monkeypatch.setattr(qt_check, "window_problem", lambda: problem)
    assert run(monkeypatch, "demo", "room", "--out", tmp_path, *options) == 0
    assert given[1] == ("browser", port)
