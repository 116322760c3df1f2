"""The window: frames, controls, keys, and the gaze that goes to the renderer."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QSize, Qt, QTimer
from PySide6.QtGui import QCloseEvent, QKeyEvent
from PySide6.QtWidgets import QDockWidget, QMainWindow, QProgressBar, QScrollArea

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from hybrid.demo.canvas import Canvas
from hybrid.demo.hud import HELP, lines_of
from hybrid.demo.panel import Panel
from hybrid.demo.thread import Ready, RenderThread
from hybrid.frame.settings import FrameSettings
from hybrid.interactive.gaze_input import GazeInput, GazeRecorder
from hybrid.interactive.meter import Meter
from hybrid.interactive.request import Request, View
from hybrid.interactive.source import Shown
from hybrid.interactive.walk import Walker

# Milliseconds between two looks at keys and gaze where they may have changed without an event: more often
# than any frame comes. Otherwise seldom, as all that the window does is taken from the renderer.
_TICK, _REST = 8, 100
# Milliseconds for which the window's size must stay the same until frames follow it: until then they are
# enlarged. With a target, each new size is measured for half a minute.
_SETTLE = 200
# How far one walks in a second, in units of how far away things are, and turns, in degrees.
_PACE, _TURN = 0.3, 60.0
_Key = Qt.Key
_WALK = {
    _Key.Key_W: (0, 0, 1),
    _Key.Key_S: (0, 0, -1),
    _Key.Key_A: (-1, 0, 0),
    _Key.Key_D: (1, 0, 0),
    _Key.Key_Q: (0, 1, 0),
    _Key.Key_E: (0, -1, 0),
}
_LOOK = {
    _Key.Key_Left: (-1, 0),
    _Key.Key_Right: (1, 0),
    _Key.Key_Up: (0, -1),
    _Key.Key_Down: (0, 1),
}


class Window(QMainWindow):
    """Shows one scene.

    Args:
        thread: renders; not started yet.
        settings: initial settings; gaze and camera are the window's.
        target_fps: initial target, None for none.
        size: of the frame, in pixels.
        gaze: where it comes from.
        folder: where pictures and gaze traces go.
        keeps_all: whether all frame times are kept.
    """

    def __init__(
        self,
        thread: RenderThread,
        settings: FrameSettings,
        target_fps: float | None,
        size: tuple[int, int],
        gaze: GazeInput,
        folder: Path,
        keeps_all: bool = False,
    ):
        super().__init__()
        self._thread, self._settings, self._target_fps = thread, settings, target_fps
        self._gaze, self._folder, self._size = gaze, folder, size
        self.meter = Meter(keeps_all)
        self.error: Exception | None = None
        self.panel: Panel | None = None
        self.walker: Walker | None = None
        self._ready: Ready | None = None
        self._asked: Request | None = None
        self._recorder: GazeRecorder | None = None
        self._held: Gaze | None = None
        self._keys: set[int] = set()
        self._hud, self._help = True, False
        self._last: Shown | None = None
        self._before = time.perf_counter()
        self.setWindowTitle("hybrid")
        self.canvas = Canvas(QSize(*size))
        self.setCentralWidget(self.canvas)
        self._bar = QProgressBar()
        self._bar.setFormat("loading the scene")
        self._bar.setMaximum(0)
        self.statusBar().addPermanentWidget(self._bar, 1)
        # Hiding the bar must not change the size of the frame.
        self.statusBar().setFixedHeight(self._bar.sizeHint().height())
        self._settling = QTimer(self, interval=_SETTLE, singleShot=True)
        self._connect()
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.tick)
        self._timer.start(_REST)
        thread.start()

    def _connect(self) -> None:
        thread, canvas = self._thread, self.canvas
        thread.progress.connect(self._on_progress)
        thread.ready.connect(self._on_ready)
        thread.arrived.connect(self._on_frame)
        thread.saved.connect(self._say)
        thread.failed.connect(self._on_failure)
        canvas.gazed.connect(self._on_gaze)
        canvas.dragged.connect(self._on_drag)
        canvas.painted.connect(self._on_painted)
        canvas.resized.connect(self._settling.start)
        self._settling.timeout.connect(self._on_settled)

    def tick(self) -> None:
        """Walks as far as keys are held, and asks for the frame that this and the gaze make."""
        now = time.perf_counter()
        seconds, self._before = now - self._before, now
        watched = bool(self._keys) or not self._gaze.is_live or self._gaze.latency > 0
        if self._timer.interval() != (interval := _TICK if watched else _REST):
            self._timer.setInterval(interval)
        if self.walker is None or self.panel is None or self._ready is None:
            return
        for key in self._keys:
            if key in _WALK:
                step = _PACE * self._ready.distance * seconds
                self.walker.walk(*(step * way for way in _WALK[_Key(key)]))
            elif key in _LOOK:
                self.walker.look(*(_TURN * seconds * way for way in _LOOK[_Key(key)]))
        before, newest = self._gaze.told, self._gaze.at(now)
        gaze = self._held or newest
        if self._recorder is not None:
            self._recorder.add(now, gaze)
        camera = self.walker.camera(*self._size)
        told = self._gaze.told
        settings = replace(self.panel.settings(), camera=camera, gaze=gaze)
        request = Request(settings, self.panel.view, told, self.panel.target_fps)
        if not request.same_frame(self._asked):
            # A gaze that is held, or held no more, has not moved.
            if self._asked is not None and gaze != self._asked.settings.gaze and told != before:
                self.meter.event(told)
            self._asked = request
            self._thread.requests.put(request)

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        self._timer.stop()
        self._thread.stop()
        event.accept()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        key = _Key(event.key())
        if key in _WALK or key in _LOOK:
            if key not in self._keys:
                self._before = time.perf_counter()
            self._keys.add(key)
            self.tick()
        elif not event.isAutoRepeat():
            self._command(key)

    def keyReleaseEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        if not event.isAutoRepeat():
            self._keys.discard(_Key(event.key()))

    def focusNextPrevChild(self, forward: bool) -> bool:  # noqa: N802
        # Tab is a command here.
        return False

    def changeEvent(self, event: object) -> None:  # noqa: N802
        # Another window gets the releases of keys that are held when it comes to the front.
        if not self.isActiveWindow():
            self._keys.clear()

    def _command(self, key: Qt.Key) -> None:
        number = key - _Key.Key_1
        if 0 <= number < len(View) and self.panel is not None:
            self.panel.views.setCurrentIndex(number)
        elif key == _Key.Key_R and self.walker is not None:
            self.walker.reset()
        elif key == _Key.Key_Space:
            self._held = None if self._held else self._gaze.at(time.perf_counter())
        elif key == _Key.Key_P and self._ready is not None:
            self._save(self._ready.name)
        elif key == _Key.Key_T and self._ready is not None:
            self._record(self._ready.name)
        elif key == _Key.Key_G:
            self.canvas.ring = not self.canvas.ring
            self.canvas.update()
        elif key == _Key.Key_H:
            self._hud = not self._hud
        elif key == _Key.Key_F1:
            self._help = not self._help
        elif key == _Key.Key_Tab and self.panel is not None:
            self._dock.setVisible(not self._dock.isVisible())
        elif key == _Key.Key_F or (key == _Key.Key_Escape and self.isFullScreen()):
            self.showNormal() if self.isFullScreen() else self.showFullScreen()
        elif key == _Key.Key_Escape:
            self.close()
        self._write()
        self.tick()

    def _save(self, name: str) -> None:
        try:
            picture = _unused(self._folder, name, ".png")
        except OSError as error:
            self._say(f"{self._folder}: cannot be read ({error.strerror})")
        else:
            self._thread.save(picture, picture.with_suffix(".exr"))

    def _record(self, name: str) -> None:
        """Begins to record the gaze, or writes what was recorded; until that is possible, it goes on."""
        if self._recorder is None:
            self._recorder = GazeRecorder()
            self._say("recording the gaze")
            return
        trace = self._recorder.trace()
        try:
            if trace is not None:
                file = _unused(self._folder, f"{name}-gaze", ".csv")
                trace.save(file)
                self._say(str(file))
            self._recorder = None
        except (UserError, OSError) as error:
            self._say(str(error))

    def _on_settled(self) -> None:
        self._size = self.canvas.width(), self.canvas.height()
        self.tick()

    def _on_progress(self, what: str, done: int, total: int) -> None:
        self.meter.pause()
        self._bar.setVisible(done < total)
        self._bar.setMaximum(total)
        self._bar.setValue(done)
        self._bar.setFormat(f"{what} %v / %m")

    def _on_ready(self, ready: Ready) -> None:
        self._ready = ready
        self.setWindowTitle(f"{ready.name} - hybrid")
        self.walker = Walker(ready.camera)
        self.panel = Panel(self._settings, self._target_fps, ready.layers)
        self.panel.changed.connect(self.tick)
        self._dock = QDockWidget("controls")
        # A small frame must not grow to the height of the controls.
        scrolled = QScrollArea()
        scrolled.setWidget(self.panel)
        scrolled.setWidgetResizable(True)
        scrolled.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        bar = scrolled.verticalScrollBar().sizeHint().width()
        scrolled.setFixedWidth(self.panel.sizeHint().width() + bar)
        self._dock.setWidget(scrolled)
        self._dock.setFeatures(QDockWidget.DockWidgetFeature.NoDockWidgetFeatures)
        self.addDockWidget(Qt.DockWidgetArea.RightDockWidgetArea, self._dock)
        self._bar.hide()
        # After Qt has laid out the controls.
        QTimer.singleShot(0, self._fit)
        self.canvas.setFocus()
        self._say("F1: help")
        self.tick()

    def _fit(self) -> None:
        """Beside the controls the frame keeps the size that was asked for."""
        self.resize(self.size() + self.canvas.sizeHint() - self.canvas.size())

    def _on_frame(self) -> None:
        shown, fresh = self._thread.frames.take(0.0)
        if fresh and shown is not None:
            self.canvas.show_frame(shown)

    def _on_painted(self, shown: Shown) -> None:
        self.meter.shown(time.perf_counter(), shown.request.asked, shown.milliseconds)
        self._last = shown
        self._write()

    def _on_gaze(self, gaze: Gaze) -> None:
        now = time.perf_counter()
        if self._gaze.is_live:
            self._gaze.move(now, gaze)
            self.tick()

    def _on_drag(self, right: float, down: float) -> None:
        if self.walker is not None and self._ready is not None:
            # The scene follows the hand.
            degrees = self._ready.camera.vertical_fov
            self.walker.look(-right * degrees, -down * degrees)

    def _on_failure(self, error: Exception) -> None:
        self.error = error
        self.close()

    def _say(self, text: str) -> None:
        self.statusBar().showMessage(text, 5000)

    def _write(self) -> None:
        hud = lines_of(self._last, self.meter) if self._hud and self._last is not None else []
        self.canvas.write(hud, HELP if self._help else [])


def _unused(folder: Path, name: str, suffix: str) -> Path:
    """A file name with a number that none has yet."""
    number = 1
    while (folder / f"{name}-{number:03d}{suffix}").exists():
        number += 1
    return folder / f"{name}-{number:03d}{suffix}"
