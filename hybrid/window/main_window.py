"""The window of Qt: hands events to the viewer, and shows what it has to show."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable

from PySide6.QtCore import QCoreApplication, QEvent, QObject, QPointF, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent, QKeyEvent, QMouseEvent
from PySide6.QtWidgets import QApplication, QDockWidget, QMainWindow, QProgressBar

from compose.eye.gaze import Gaze
from hybrid.window.canvas import Canvas
from hybrid.window.key_bindings import COMMANDS, OF_THE_SHELL, Command
from hybrid.window.messages import ShownFrame
from hybrid.window.panel import Panel, controls_dock
from hybrid.window.viewer import Viewer

_Key = Qt.Key
# Keys that are not the letter or digit that they write.
_NAMES: dict[int, str] = {
    _Key.Key_Left: "ArrowLeft",
    _Key.Key_Right: "ArrowRight",
    _Key.Key_Up: "ArrowUp",
    _Key.Key_Down: "ArrowDown",
    _Key.Key_Tab: "Tab",
    _Key.Key_F1: "F1",
    _Key.Key_Escape: "Escape",
}


class _Posted(QObject):
    """Calls functions on the thread that it was made on."""

    post = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self.post.connect(self._call)

    def _call(self, function: Callable[[], None]) -> None:
        function()


class MainWindow(QMainWindow):
    """Shows one scene.

    Attributes:
        viewer: what is shown, and gets all events.
        panel, dock: the controls; None until the scene is loaded.
    """

    def __init__(self, viewer: Viewer):
        super().__init__()
        self.viewer, self._posted = viewer, _Posted()
        self.canvas = Canvas(QSize(*viewer.options.size))
        self.panel: Panel | None = None
        self.dock: QDockWidget | None = None
        self.setCentralWidget(self.canvas)
        self._bar = bar = QProgressBar()
        self.statusBar().addPermanentWidget(bar, 1)
        # Hiding the bar must not change the size of the frame.
        self.statusBar().setFixedHeight(bar.sizeHint().height())
        self._timer = QTimer(self, interval=self._interval)
        self._timer.timeout.connect(self._tick)
        self.canvas.happened.connect(self._handle)
        self.canvas.painted.connect(lambda shown: viewer.painted(shown, time.perf_counter()))
        viewer.open(self, self._posted.post.emit)
        self.refresh()
        self._timer.start()

    def show_frame(self, shown: ShownFrame) -> None:
        """Shows a frame; the viewer hears of it once it is painted."""
        self.canvas.show_frame(shown)

    def refresh(self) -> None:
        """Shows texts, progress and controls as they are now."""
        viewer = self.viewer
        self.setWindowTitle(viewer.title)
        self.canvas.write(viewer.hud, viewer.overlay, viewer.shows(Command.RING))
        if self.statusBar().currentMessage() != viewer.line:
            self.statusBar().showMessage(viewer.line)
        self._bar.setVisible(viewer.progress is not None)
        if viewer.progress is not None:
            activity, done, total = viewer.progress
            self._bar.setMaximum(total)
            self._bar.setValue(done)
            self._bar.setFormat(f"{activity} %v / %m" if total else activity)
        if self.panel is None and viewer.controls is not None:
            self.panel = Panel(viewer.controls)
            self.panel.chosen.connect(self._choose)
            self.dock = controls_dock(self.panel)
            self.addDockWidget(Qt.DockWidgetArea.RightDockWidgetArea, self.dock)
            # As large as the frame needs it beside the controls, once Qt has laid those out.
            wider = lambda: self.resize(self.size() + self.canvas.sizeHint() - self.canvas.size())  # noqa: E731
            QTimer.singleShot(0, wider)
            self.canvas.setFocus()
        if self.panel is not None and self.dock is not None:
            self.panel.refresh()
            self.dock.setVisible(viewer.shows(Command.CONTROLS))

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        self._timer.stop()
        self.viewer.close()
        event.accept()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        key = _name(event)
        command = COMMANDS.get(key)
        if command not in OF_THE_SHELL:
            self._handle({"type": "key_down", "key": key, "repeat": event.isAutoRepeat()})
        elif not event.isAutoRepeat():
            self._show_in_full() if command is Command.FULL_SCREEN else self._leave()

    def keyReleaseEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        if not event.isAutoRepeat():
            self._handle({"type": "key_up", "key": _name(event)})

    def focusNextPrevChild(self, forward: bool) -> bool:  # noqa: N802
        # Tab is a command here.
        return False

    def changeEvent(self, event: object) -> None:  # noqa: N802
        # When another window comes to the front, it gets the releases of held keys.
        if not self.isActiveWindow():
            self._handle({"type": "blur"})

    def _handle(self, event: dict[str, object]) -> None:
        self.viewer.handle(event)
        self._wait()

    def _choose(self, name: str, value: int) -> None:
        self._handle({"type": "control", "name": name, "value": value})

    def _tick(self) -> None:
        if self.viewer.mouse_moves and self.viewer.bench is not None:
            move_mouse(self, self.viewer.bench.gaze(time.perf_counter()))
        self.viewer.tick()
        self._wait()

    @property
    def _interval(self) -> int:
        """Milliseconds until the next tick."""
        return round(1000 * self.viewer.interval)

    def _wait(self) -> None:
        """Has the next tick come in time; starts no timer anew that would come anyway."""
        if self._timer.interval() != self._interval:
            self._timer.setInterval(self._interval)

    def _show_in_full(self) -> None:
        self.showNormal() if self.isFullScreen() else self.showFullScreen()

    def _leave(self) -> None:
        self.showNormal() if self.isFullScreen() else self.close()


def _name(event: QKeyEvent) -> str:
    """The name of a key in events; empty if it has none."""
    key = event.key()
    return _NAMES.get(key) or (chr(key).lower() if key < 128 else "")


def move_mouse(window: MainWindow, gaze: Gaze) -> None:
    """Moves the mouse to a point of the frame, with no button pressed."""
    canvas = window.canvas
    point: QPointF = canvas.point_of(gaze)
    none = Qt.MouseButton.NoButton
    event = QMouseEvent(
        QEvent.Type.MouseMove, point, canvas.mapToGlobal(point), none, none, Qt.KeyboardModifier.NoModifier
    )
    QCoreApplication.sendEvent(canvas, event)


def run_window(viewer: Viewer) -> None:
    """Opens a window of Qt, and returns when it is closed; raises what ended the renderer."""
    application = QApplication(sys.argv[:1])
    window = MainWindow(viewer)
    window.show()
    # Qt does not notice Ctrl-C by itself.
    signal.signal(signal.SIGINT, lambda number, frame: window.close())
    application.exec()
    if viewer.error is not None:
        raise viewer.error
