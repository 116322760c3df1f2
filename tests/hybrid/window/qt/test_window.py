"""The window, with a renderer that answers at once or not at all: what it asks for, and what it shows."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)

from PySide6.QtCore import QEvent, QObject, QPointF, Qt, Signal
from PySide6.QtGui import QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDockWidget

from compose.eye.gaze import Gaze, GazeTrace, load_gaze_trace
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.application import move_mouse
from hybrid.window.gaze_input import GazeInput
from hybrid.window.main_window import MainWindow, WindowOptions
from hybrid.window.messages import Newest, Ready, Request, ShownView
from tests.hybrid.window.qt.fakes import CAMERA, shown

Key = Qt.Key
HERE, THERE = Gaze(0.25, 0.5), Gaze(0.75, 0.5)


class Thread(QObject):
    """A render thread that does nothing by itself."""

    progress = Signal(str, int, int)
    ready = Signal(object)
    arrived = Signal()
    saved = Signal(str)
    failed = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self.requests: Newest[Request] = Newest()
        self.frames: Newest[Any] = Newest()
        self.files: list[Path] = []
        self.started = self.stopped = False

    def start(self) -> None:
        self.started = True

    def stop(self) -> None:
        self.stopped = True

    def save(self, png: Path) -> None:
        self.files.append(png)
        png.touch()


class Opened:
    """A window, its renderer, and the time, which only the test advances."""

    def __init__(self, folder: Path, gaze: GazeInput, target_fps: float | None, clock: list[float]):
        self.thread, self.gaze, self.clock = Thread(), gaze, clock
        thread: Any = self.thread
        options = WindowOptions((320, 240), 0.0, folder, target_fps)
        self.window = MainWindow(thread, INTERACTIVE, gaze, options)
        self.window.show()

    def load(self, seconds: float | None = None) -> None:
        """Loads the scene, and lets Qt lay out the controls."""
        self.thread.ready.emit(Ready("box", CAMERA, 2.0, 3, seconds))
        QApplication.processEvents()
        QApplication.processEvents()

    def asked(self) -> Request | None:
        """The request that is new since the last call."""
        return self.thread.requests.take()

    def answer(self, **other: Any) -> None:
        """Renders the newest request and shows the frame."""
        request = self.window.request
        assert request is not None
        self.thread.frames.put(shown(request, **other))
        self.thread.arrived.emit()
        self.window.canvas.grab()

    def event(self, kind: QEvent.Type, key: int, repeated: bool = False) -> None:
        none = Qt.KeyboardModifier.NoModifier
        QApplication.sendEvent(self.window.canvas, QKeyEvent(kind, key, none, "", repeated))

    def key(self, key: int) -> None:
        self.event(QEvent.Type.KeyPress, key)
        self.event(QEvent.Type.KeyRelease, key)

    def message(self) -> str:
        return self.window.statusBar().currentMessage()


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    return now


@pytest.fixture
def make(application, clock, tmp_path) -> Iterator[Any]:
    """Makes windows, which close with the test."""
    made: list[Opened] = []

    def make(latency: float = 0.0, trace: GazeTrace | None = None, target_fps: float | None = None) -> Opened:
        made.append(Opened(tmp_path, GazeInput(latency, trace), target_fps, clock))
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


def test_nothing_is_asked_for_before_the_scene_is_loaded(make):
    opened = make()
    assert opened.thread.started
    move_mouse(opened.window, HERE)
    for key in (Key.Key_1, Key.Key_R, Key.Key_P, Key.Key_T, Key.Key_Tab, Key.Key_W):
        opened.key(key)
    assert opened.asked() is None
    assert not opened.thread.files


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
    assert opened.message() == "F1: help"
    assert window.canvas.hasFocus()
    # Only a bench keeps all frames.
    assert window.meter.intervals.maxlen == 100


def test_a_loaded_scene_is_asked_for_with_the_initial_settings(make):
    opened = make(target_fps=24.5)
    opened.load()
    request = opened.asked()
    assert request.settings == replace(INTERACTIVE, layers=(1, 3), camera=CAMERA)
    assert (request.view, request.target_fps) == (ShownView.COMPOSITE, 24.5)
    assert opened.window.request is request
    assert opened.window.windowTitle() == "box - hybrid"


def test_the_mouse_is_the_gaze_of_the_next_request(opened, clock):
    clock[0] = 105.0
    move_mouse(opened.window, HERE)
    request = opened.asked()
    assert request.settings.gaze == HERE
    assert request.gaze_time == 105.0
    # The same frame is not asked for again.
    clock[0] = 106.0
    opened.window.tick()
    assert opened.asked() is None


def test_latency_counts_from_the_mouse_to_the_painted_frame(opened, clock):
    opened.answer()
    clock[0] = 105.0
    move_mouse(opened.window, HERE)
    clock[0] = 105.06
    opened.answer()
    assert list(opened.window.meter.latencies) == [(105.06, pytest.approx(0.06))]
    assert [seconds for _, seconds in opened.window.meter.intervals] == [pytest.approx(5.06)]
    assert opened.window.shown.request.settings.gaze == HERE


def test_a_late_gaze_is_asked_for_when_it_is_known(make, clock):
    opened = make(latency=0.1)
    opened.load()
    opened.asked()
    clock[0] = 105.0
    move_mouse(opened.window, HERE)
    clock[0] = 105.09
    opened.window.tick()
    assert opened.asked() is None
    clock[0] = 105.11
    opened.window.tick()
    request = opened.asked()
    assert (request.settings.gaze, request.gaze_time) == (HERE, 105.0)
    clock[0] = 105.15
    opened.answer()
    assert [seconds for _, seconds in opened.window.meter.latencies] == [pytest.approx(0.15)]


def test_a_late_gaze_needs_no_further_event(make, clock):
    opened = make(latency=0.1)
    opened.load()
    opened.asked()
    move_mouse(opened.window, HERE)
    clock[0] += 0.2
    request, waited = None, 0
    while request is None and waited < 1000:
        QTest.qWait(10)
        request, waited = opened.asked(), waited + 1
    assert request is not None
    assert request.settings.gaze == HERE


def test_a_trace_replaces_the_mouse(make, clock):
    opened = make(trace=GazeTrace((0.0, 1.0, 2.0), (HERE, THERE, THERE)))
    opened.load()
    assert opened.asked().settings.gaze == HERE
    clock[0] = 101.5
    opened.window.tick()
    assert opened.asked().settings.gaze == THERE
    move_mouse(opened.window, Gaze(0.1, 0.1))
    assert opened.asked() is None


def test_a_held_gaze_stays_and_holding_it_is_no_movement(opened, clock):
    opened.answer()
    clock[0] = 101.0
    move_mouse(opened.window, HERE)
    opened.answer()
    opened.key(Key.Key_Space)
    before = len(opened.window.meter.latencies)
    opened.asked()
    clock[0] = 110.0
    move_mouse(opened.window, THERE)
    assert opened.asked() is None
    clock[0] = 120.0
    opened.key(Key.Key_Space)
    assert opened.asked().settings.gaze == THERE
    opened.answer()
    assert len(opened.window.meter.latencies) == before == 1


def test_a_change_of_settings_is_no_movement(opened, clock):
    opened.answer()
    clock[0] = 101.0
    opened.window.panel.spp.setValue(3)
    assert opened.asked().settings.spp == 3
    opened.answer()
    assert not opened.window.meter.latencies


def test_the_timer_ticks_often_only_while_something_may_change(make, opened):
    timer = opened.window._timer
    opened.window.tick()
    assert timer.interval() == 100
    opened.event(QEvent.Type.KeyPress, Key.Key_W)
    assert timer.interval() == 8
    opened.event(QEvent.Type.KeyRelease, Key.Key_W)
    opened.window.tick()
    assert timer.interval() == 100
    for other in (make(latency=0.01), make(trace=GazeTrace((0.0,), (HERE,)))):
        other.window.tick()
        assert other.window._timer.interval() == 8


def test_held_keys_walk_until_they_are_released(opened, clock):
    clock[0] = 103.0
    opened.event(QEvent.Type.KeyPress, Key.Key_W)
    clock[0] = 103.5
    opened.event(QEvent.Type.KeyPress, Key.Key_W, repeated=True)
    # Half a second at 0.3 of two units a second.
    assert opened.asked().settings.camera.position == pytest.approx([0, 0, 0.3])
    clock[0] = 104.0
    opened.event(QEvent.Type.KeyRelease, Key.Key_W, repeated=True)
    opened.window.tick()
    assert opened.asked().settings.camera.position == pytest.approx([0, 0, 0.6])
    opened.event(QEvent.Type.KeyRelease, Key.Key_W)
    clock[0] = 105.0
    opened.window.tick()
    assert opened.asked() is None
    opened.key(Key.Key_R)
    assert opened.asked().settings.camera == CAMERA


def test_another_window_in_front_releases_all_keys(opened, clock, monkeypatch):
    opened.event(QEvent.Type.KeyPress, Key.Key_W)
    for active in (True, False):
        monkeypatch.setattr(opened.window, "isActiveWindow", lambda active=active: active)
        QApplication.sendEvent(opened.window, QEvent(QEvent.Type.ActivationChange))
        clock[0] += 1
        opened.window.tick()
        assert (opened.asked() is not None) == active


def test_dragging_moves_the_scene_with_the_hand(opened):
    # Half a height to the right: the camera turns left by half of its field of view.
    opened.window.canvas.dragged.emit(0.5, 0.0)
    opened.window.tick()
    half = np.radians(CAMERA.vertical_fov / 2)
    forward = opened.asked().settings.camera.camera_to_world[:3, 2]
    assert forward == pytest.approx([-np.sin(half), 0, np.cos(half)])
    # A quarter downwards: it turns up.
    opened.window.canvas.dragged.emit(0.0, 0.25)
    opened.window.tick()
    assert opened.asked().settings.camera.camera_to_world[1, 2] == pytest.approx(-np.sin(half / 2))


@pytest.mark.parametrize("view", ShownView)
def test_number_keys_choose_the_view(opened, view):
    opened.key(Key.Key_3)
    opened.asked()
    opened.key(Key.Key_1 + list(ShownView).index(view))
    assert opened.window.request.view is view


def test_keys_show_and_hide_texts_ring_and_controls(opened, monkeypatch):
    written: list[tuple[list[str], list[str]]] = []
    monkeypatch.setattr(opened.window.canvas, "write", lambda hud, overlay: written.append((hud, overlay)))
    opened.answer()
    assert written[-1][0]
    assert not written[-1][1]
    opened.key(Key.Key_H)
    assert written[-1] == ([], [])
    opened.key(Key.Key_F1)
    assert any(line.startswith("Space") for line in written[-1][1])
    opened.key(Key.Key_F1)
    opened.key(Key.Key_H)
    assert written[-1][0]
    assert not written[-1][1]
    before = opened.window.canvas.grab().toImage()
    opened.key(Key.Key_G)
    assert opened.window.canvas.grab().toImage() != before
    dock = opened.window.findChild(QDockWidget)
    assert not dock.isHidden()
    opened.key(Key.Key_Tab)
    assert dock.isHidden()
    opened.key(Key.Key_Tab)
    assert not dock.isHidden()


def test_a_scene_that_moves_plays_and_pauses(make, clock):
    window = make()
    window.load(seconds=4.0)
    assert window.asked().settings.time == 0
    clock[0] += 1
    window.window.tick()
    assert window.asked() is None
    window.key(Key.Key_M)
    clock[0] += 1
    window.window.tick()
    assert window.asked().settings.time == pytest.approx(0.25)
    assert window.window.panel.time.value() == 250
    window.key(Key.Key_M)
    clock[0] += 1
    window.window.tick()
    assert window.asked() is None
    window.window.panel.time.setValue(800)
    window.window.tick()
    assert window.asked().settings.time == pytest.approx(0.8)


def test_a_scene_that_stands_still_does_not_play(opened):
    opened.asked()
    opened.key(Key.Key_M)
    opened.window.tick()
    assert opened.asked() is None
    assert opened.window.panel.play is None


def test_the_frame_takes_the_place_of_hidden_controls(opened):
    before = opened.window.canvas.width()
    opened.key(Key.Key_Tab)
    QApplication.processEvents()
    assert opened.window.canvas.width() > before + 50


def test_keys_that_mean_nothing_do_nothing(opened):
    for key in (Key.Key_X, Key.Key_9, 0, 0x01FFFFFF):
        opened.key(key)
    assert opened.asked() is None


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


def test_screenshots_are_numbered(opened, tmp_path):
    opened.key(Key.Key_P)
    opened.key(Key.Key_P)
    assert opened.thread.files == [tmp_path / "box-001.png", tmp_path / "box-002.png"]
    opened.thread.saved.emit("box-001.png and .exr")
    assert opened.message() == "box-001.png and .exr"


def test_a_folder_that_cannot_be_read_is_a_message(opened, monkeypatch):
    def fails(self: Path) -> bool:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "exists", fails)
    opened.key(Key.Key_P)
    assert opened.message().endswith("cannot be read (Permission denied)")
    assert not opened.thread.files


def test_the_gaze_is_recorded_as_it_is_asked_for(opened, clock, tmp_path):
    opened.key(Key.Key_T)
    assert opened.message() == "recording the gaze"
    for clock[0], gaze in ((101.0, HERE), (102.5, THERE)):
        move_mouse(opened.window, gaze)
    opened.key(Key.Key_T)
    assert opened.message() == str(tmp_path / "box-gaze-001.csv")
    trace = load_gaze_trace(tmp_path / "box-gaze-001.csv")
    assert trace == GazeTrace((0.0, 1.0, 2.5), (Gaze(), HERE, THERE))


def test_progress_shows_a_bar_and_counts_as_no_frame(opened, clock):
    bar = opened.window._bar
    opened.answer()
    opened.thread.progress.emit("measuring settings", 2, 5)
    assert not bar.isHidden()
    assert (bar.value(), bar.maximum(), bar.format()) == (2, 5, "measuring settings %v / %m")
    opened.thread.progress.emit("measuring settings", 5, 5)
    assert bar.isHidden()
    clock[0] = 130.0
    opened.answer()
    assert not opened.window.meter.intervals


def test_frames_follow_a_new_size_once_it_has_settled(opened):
    window = opened.window
    assert (window.canvas.width(), window.canvas.height()) == (320, 240)
    window.resize(window.width() - 20, window.height() - 40)
    window.tick()
    assert opened.asked() is None
    assert window._settling.isActive()
    assert (window._settling.interval(), window._settling.isSingleShot()) == (200, True)
    window._settling.timeout.emit()
    camera = opened.asked().settings.camera
    assert (camera.width, camera.height) == (300, 200)


def test_an_error_of_the_renderer_closes_the_window(opened):
    problem = ValueError("something is wrong")
    opened.thread.failed.emit(problem)
    assert opened.window.error is problem
    assert not opened.window.isVisible()
    assert opened.thread.stopped


def test_a_frame_that_was_shown_already_is_not_shown_again(opened):
    opened.answer()
    opened.thread.arrived.emit()
    opened.window.canvas.grab()
    assert len(opened.window.meter.passes) == 1


def test_the_point_of_a_gaze_is_where_the_mouse_goes(opened):
    opened.answer()
    assert opened.window.canvas.point_of(HERE) == QPointF(80, 120)
    move_mouse(opened.window, HERE)
    assert opened.asked().settings.gaze == HERE
