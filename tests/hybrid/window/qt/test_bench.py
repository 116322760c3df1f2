"""A window in use: the mouse moves, another process keeps a core busy, and the window closes."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)

from PySide6.QtCore import QEvent, QPointF, QSize
from PySide6.QtWidgets import QMainWindow

from compose.eye.gaze import Gaze
from hybrid.window import application as bench
from hybrid.window.application import WindowBench, move_mouse
from hybrid.window.canvas import Canvas
from tests.hybrid.window.qt.fakes import CAMERA, REQUEST, shown


class Window(QMainWindow):
    """A canvas in a window, and where the mouse was on it."""

    def __init__(self) -> None:
        super().__init__()
        self.canvas = Canvas(QSize(320, 240))
        self.canvas.resize(320, 240)
        self.gazes: list[Gaze] = []
        self.canvas.gazed.connect(self.gazes.append)
        self.closed = False

    def closeEvent(self, event: QEvent) -> None:  # noqa: N802
        self.closed = True


class Process:
    """A process that ends when the test says so."""

    started: ClassVar[list[list[str]]] = []
    ended: ClassVar[bool] = False

    def __init__(self, command: list[str]):
        self.started.append(command)

    def poll(self) -> int | None:
        return 0 if self.ended else None


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(Process, "started", [])
    monkeypatch.setattr(Process, "ended", False)
    monkeypatch.setattr(bench, "subprocess", SimpleNamespace(Popen=Process))
    return now


def begun(window: Any, moves: bool = True, load: float = 0.0) -> WindowBench:
    """Ten seconds of a window whose first frame has come."""
    measured = WindowBench(window, 10.0, moves, load)
    window.canvas.painted.emit(shown())
    return measured


def test_the_mouse_moves_to_a_point_of_the_frame(application):
    window: Any = Window()
    move_mouse(window, Gaze(0.25, 0.75))
    assert window.gazes == [Gaze(0.25, 0.75)]
    assert window.canvas.point_of(Gaze(0.25, 0.75)) == QPointF(80, 180)


def test_it_begins_with_the_first_frame_of_the_final_size(application, clock):
    window: Any = Window()
    measured = WindowBench(window, 10.0, True)
    small = replace(REQUEST.settings, camera=CAMERA.resized(160, 120))
    window.canvas.painted.emit(shown(replace(REQUEST, settings=small)))
    assert not measured._timer.isActive()
    clock[0] = 107.0
    window.canvas.painted.emit(shown())
    assert measured._timer.isActive()
    # Four seconds of warm-up do not count.
    assert measured.start == 111.0
    clock[0] = 108.0
    window.canvas.painted.emit(shown())
    assert measured.start == 111.0
    measured._timer.stop()


def test_the_mouse_follows_a_curve_and_the_window_closes_in_time(application, clock):
    window: Any = Window()
    measured = begun(window)
    for clock[0] in (100.0, 102.0, 104.0, 113.9):
        measured._step()
    expected = [(0.5, 0.5), (0.8, 0.5), (0.5, 0.5)]
    for gaze, (x, y) in zip(window.gazes, expected, strict=False):
        assert (gaze.x, gaze.y) == pytest.approx((x, y), abs=1e-6)
    assert len(window.gazes) == 4
    assert not window.closed
    clock[0] = 114.1
    measured._step()
    assert window.closed
    assert not measured._timer.isActive()
    assert len(window.gazes) == 4
    assert measured.loaded is None


def test_a_replayed_gaze_is_not_disturbed(application, clock):
    window: Any = Window()
    measured = begun(window, moves=False)
    clock[0] = 105.0
    measured._step()
    assert not window.gazes
    measured._timer.stop()


def test_a_load_runs_once_in_the_middle_and_is_timed(application, clock):
    window: Any = Window()
    measured = begun(window, load=2.0)
    # Four seconds of warm-up, then ten of which the middle two are loaded.
    clock[0] = 107.9
    measured._step()
    assert not Process.started
    for clock[0] in (108.1, 109.0, 110.0):
        measured._step()
    assert [command[-1] for command in Process.started] == ["2.0"]
    assert measured.loaded is None
    Process.ended = True
    for clock[0] in (110.2, 111.0):
        measured._step()
    assert measured.loaded == pytest.approx((4.1, 6.2))
    assert len(Process.started) == 1
    measured._timer.stop()


def test_the_command_measures_a_real_scene(made, offscreen, tmp_path):
    out = tmp_path / "bench.json"
    command = [sys.executable, "-m", "hybrid.cli.main", "demo", "cornell", "--forest", made / "box.forest"]
    command += ["--size", 96, 64, "--bench", 1, "--json", out]
    ended = subprocess.run(
        [str(part) for part in command],
        env=offscreen | {"HYBRID_HOME": str(made / "home")},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads(out.read_text())
    assert {"width", "height", "fps", "ms", "latency_ms", "frames", "machine"} < found.keys()
    assert {"trace", "fovea", "splat", "blend", "total"} < found["passes"].keys()
    assert "from mouse to screen" in ended.stdout
