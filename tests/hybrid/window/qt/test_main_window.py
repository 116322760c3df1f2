"""The window of Qt, with a renderer that answers at once or not at all."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)

from PySide6.QtCore import QEvent, QPointF, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from compose.eye.gaze import Gaze
from hybrid.window.main_window import MainWindow, move_mouse
from hybrid.window.messages import Ready, Request
from tests.hybrid.window import fakes
from tests.hybrid.window.fakes import CAMERA, shown

Key = Qt.Key
HERE = Gaze(0.25, 0.5)


class Opened:
    """A window, and its renderer."""

    def __init__(self, folder: Path, **options: Any):
        self.viewer = fakes.viewer(folder, **options)
        self.thread: Any = self.viewer.thread
        self.window = MainWindow(self.viewer)
        self.window.show()

    def load(self, seconds: float | None = None) -> None:
        """Loads the scene, and lets Qt lay out the controls."""
        self.viewer.on_ready(Ready("box", CAMERA, 2.0, 3, seconds))
        QApplication.processEvents()
        QApplication.processEvents()

    def asked(self) -> Request | None:
        """The request that is new since the last call."""
        return self.thread.requests.take()

    def answer(self) -> None:
        """Renders the newest request, and lets the window paint it."""
        assert self.viewer.request is not None
        self.thread.frames.put(shown(self.viewer.request))
        self.viewer.on_frame()
        self.window.canvas.grab()

    def event(self, kind: QEvent.Type, key: int, repeated: bool = False) -> None:
        none = Qt.KeyboardModifier.NoModifier
        QApplication.sendEvent(self.window.canvas, QKeyEvent(kind, key, none, "", repeated))

    def key(self, key: int) -> None:
        self.event(QEvent.Type.KeyPress, key)
        self.event(QEvent.Type.KeyRelease, key)


@pytest.fixture
def make(application, tmp_path) -> Iterator[Any]:
    """Makes windows, which close with the test."""
    made: list[Opened] = []

    def make(**options: Any) -> Opened:
        made.append(Opened(tmp_path, **options))
        return made[-1]

    yield make
    for opened in made:
        opened.window.close()


@pytest.fixture
def opened(make) -> Opened:
    """A window whose scene is loaded."""
    opened = make()
    opened.load()
    opened.asked()
    return opened


def test_a_bar_is_busy_until_the_scene_is_loaded(make):
    opened = make()
    window, bar = opened.window, opened.window._bar
    QApplication.processEvents()
    assert window.windowTitle() == "hybrid"
    # Without a maximum, a bar shows no share.
    assert (bar.format(), bar.maximum(), bar.isVisible()) == ("loading the scene", 0, True)
    assert bar.parent() is window.statusBar()
    assert bar.width() > 200
    height = window.canvas.height()
    opened.load()
    assert bar.isHidden()
    assert window.canvas.height() == height
    assert window.windowTitle() == "box - hybrid"
    assert window.statusBar().currentMessage() == "F1: help"
    assert window.canvas.hasFocus()


def test_progress_and_status_are_shown(opened):
    bar = opened.window._bar
    opened.viewer.on_progress("measuring settings", 2, 5)
    assert not bar.isHidden()
    assert (bar.value(), bar.maximum(), bar.format()) == (2, 5, "measuring settings %v / %m")
    opened.viewer.on_progress("measuring settings", 5, 5)
    assert bar.isHidden()
    opened.viewer.say("")
    opened.viewer.on_status("learning: 31.2 dB after 40 s")
    assert opened.window.statusBar().currentMessage() == "learning: 31.2 dB after 40 s"


def test_what_is_posted_is_called_on_this_thread(opened):
    called = []
    opened.thread.post(lambda: called.append(True))
    QApplication.processEvents()
    assert called == [True]


def test_the_mouse_is_the_gaze_of_the_next_request(opened):
    opened.answer()
    assert opened.window.canvas.point_of(HERE) == QPointF(80, 120)
    move_mouse(opened.window, HERE)
    assert opened.asked().settings.gaze == HERE
    opened.answer()
    assert opened.viewer.shown.request.settings.gaze == HERE
    assert len(opened.viewer.meter.latencies) == 1


def test_a_late_gaze_needs_no_further_event(make):
    opened = make(latency=0.1)
    opened.load()
    opened.asked()
    move_mouse(opened.window, HERE)
    request, waited = None, 0
    while request is None and waited < 1000:
        QTest.qWait(10)
        request, waited = opened.asked(), waited + 1
    assert request is not None
    assert request.settings.gaze == HERE


def test_keys_have_their_names(opened):
    for key, name in (
        (Key.Key_W, "w"),
        (Key.Key_1, "1"),
        (Key.Key_Space, " "),
        (Key.Key_Tab, "Tab"),
        (Key.Key_Left, "ArrowLeft"),
        (Key.Key_F1, "F1"),
        (Key.Key_Shift, ""),
    ):
        pressed = []
        opened.viewer.handle = pressed.append
        opened.event(QEvent.Type.KeyPress, key, repeated=True)
        opened.event(QEvent.Type.KeyRelease, key)
        assert pressed == [
            {"type": "key_down", "key": name, "repeat": True},
            {"type": "key_up", "key": name},
        ]


def test_the_timer_ticks_often_only_while_something_may_change(opened):
    timer = opened.window._timer
    assert timer.interval() == 100
    opened.event(QEvent.Type.KeyPress, Key.Key_W)
    assert timer.interval() == 8
    opened.event(QEvent.Type.KeyRelease, Key.Key_W, repeated=True)
    assert timer.interval() == 8
    opened.event(QEvent.Type.KeyRelease, Key.Key_W)
    assert timer.interval() == 100


def test_another_window_in_front_releases_all_keys(opened, monkeypatch):
    opened.event(QEvent.Type.KeyPress, Key.Key_W)
    for active in (True, False):
        monkeypatch.setattr(opened.window, "isActiveWindow", lambda active=active: active)
        QApplication.sendEvent(opened.window, QEvent(QEvent.Type.ActivationChange))
        assert (opened.viewer.interval < 0.1) == active


def test_a_control_changes_the_next_request(opened):
    opened.window.panel.widgets["samples"].setValue(3)
    assert opened.asked().settings.spp == 3
    opened.key(Key.Key_4)
    assert opened.window.panel.widgets["view"].currentIndex() == 3


def test_the_frame_takes_the_place_of_hidden_controls(opened):
    before = opened.window.canvas.width()
    assert before == 320
    opened.key(Key.Key_Tab)
    QApplication.processEvents()
    assert opened.window.dock.isHidden()
    assert opened.window.canvas.width() > before + 50
    opened.key(Key.Key_Tab)
    assert not opened.window.dock.isHidden()


def test_texts_and_ring_are_drawn(opened):
    opened.answer()
    for key in (Key.Key_G, Key.Key_H, Key.Key_F1):
        before = opened.window.canvas.grab().toImage()
        opened.key(key)
        assert opened.window.canvas.grab().toImage() != before


def test_full_screen_is_left_before_the_window_closes(opened):
    window = opened.window
    opened.key(Key.Key_F)
    assert window.isFullScreen()
    opened.key(Key.Key_Escape)
    assert not window.isFullScreen()
    assert window.isVisible()
    opened.key(Key.Key_F)
    opened.key(Key.Key_F)
    assert not window.isFullScreen()
    opened.key(Key.Key_Escape)
    assert not window.isVisible()
    assert opened.thread.stopped
    assert not window._timer.isActive()


def test_an_error_of_the_renderer_closes_the_window(opened):
    opened.viewer.on_failure(ValueError("something is wrong"))
    assert not opened.window.isVisible()
    assert opened.thread.stopped


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
