"""The window of Qt: hands events to the viewer, and shows what it has to show."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from functools import partial

from PySide6.QtCore import QCoreApplication, QEvent, QPointF, QSignalBlocker, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent, QKeyEvent, QMouseEvent
from PySide6.QtWidgets import (
    QApplication,
    QCheckBox,
    QComboBox,
    QDockWidget,
    QFormLayout,
    QLabel,
    QMainWindow,
    QProgressBar,
    QScrollArea,
    QSlider,
    QWidget,
)

from compose.eye.gaze import Gaze
from hybrid.window.canvas import Canvas
from hybrid.window.controls import Control, Controls
from hybrid.window.key_bindings import COMMANDS, OF_THE_SHELL, Command
from hybrid.window.messages import ShownFrame
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


# Widths of a slider in pixels, and of a list in letters.
_SLIDER_WIDTH, _LETTERS = 100, 12


class Panel(QWidget):
    """Sliders, lists and switches that show the controls' values; `widgets` are those of each, by name."""

    # Name and value: a control was changed by hand.
    chosen = Signal(str, int)

    def __init__(self, controls: Controls):
        super().__init__()
        self._controls, form = controls, QFormLayout(self)
        self._labels: dict[str, QLabel] = {}
        self.widgets: dict[str, QSlider | QComboBox | QCheckBox] = {}
        for control in controls.all:
            self.widgets[control.name] = widget = self._widget(control)
            self._labels[control.name] = label = QLabel()
            form.addRow(label, widget)
        # Keys belong to the frame: a control with the focus would react to arrows and letters.
        for widget in self.findChildren(QWidget):
            widget.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._seen: dict[str, int] = {}
        self.refresh()

    def refresh(self) -> None:
        """Shows the values as they are now."""
        if self._seen == self._controls.values:
            return
        self._seen = dict(self._controls.values)
        for control in self._controls.all:
            widget, value = self.widgets[control.name], self._controls.values[control.name]
            with QSignalBlocker(widget):
                if isinstance(widget, QSlider):
                    widget.setValue(value)
                elif isinstance(widget, QComboBox):
                    widget.setCurrentIndex(value)
                else:
                    widget.setChecked(bool(value))
            widget.setEnabled(self._controls.is_enabled(control.name))
            self._labels[control.name].setText(self._controls.text(control))

    def _widget(self, control: Control) -> QSlider | QComboBox | QCheckBox:
        chosen = partial(self.chosen.emit, control.name)
        if control.kind == "slider":
            slider = QSlider(Qt.Orientation.Horizontal)
            slider.setRange(control.low, control.high)
            slider.setMinimumWidth(_SLIDER_WIDTH)
            slider.valueChanged.connect(chosen)
            return slider
        if control.kind == "switch":
            box = QCheckBox()
            box.toggled.connect(lambda on: chosen(int(on)))
            return box
        entries = QComboBox()
        entries.addItems(control.entries)
        # The longest entry must not take the room of the frame.
        entries.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        entries.setMinimumContentsLength(_LETTERS)
        entries.currentIndexChanged.connect(chosen)
        return entries


def controls_dock(panel: Panel) -> QDockWidget:
    """A dock that shows a panel in its full width and scrolls it where it is too high."""
    # Without scrolling, a small frame would grow to the height of the controls.
    scrolled = QScrollArea()
    scrolled.setWidget(panel)
    scrolled.setWidgetResizable(True)
    scrolled.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    bar = scrolled.verticalScrollBar().sizeHint().width()
    scrolled.setFixedWidth(panel.sizeHint().width() + bar)
    dock = QDockWidget("controls")
    dock.setWidget(scrolled)
    dock.setFeatures(QDockWidget.DockWidgetFeature.NoDockWidgetFeatures)
    return dock


class MainWindow(QMainWindow):
    """Shows one scene.

    Attributes:
        viewer: what is shown, and gets all events.
        panel, dock: the controls; None until the scene is loaded.
    """

    # A function, to be called on the window's thread.
    posted = Signal(object)

    def __init__(self, viewer: Viewer):
        super().__init__()
        self.viewer = viewer
        self.canvas = Canvas(QSize(*viewer.options.size))
        self.panel: Panel | None = None
        self.dock: QDockWidget | None = None
        self.setCentralWidget(self.canvas)
        self._bar = bar = QProgressBar()
        self.statusBar().addPermanentWidget(bar, 1)
        # Hiding the bar must not change the size of the frame.
        self.statusBar().setFixedHeight(bar.sizeHint().height())
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._tick)
        self.posted.connect(self._call)
        self.canvas.happened.connect(self._handle)
        self.canvas.painted.connect(lambda shown: viewer.painted(shown, time.perf_counter()))
        viewer.open(self, self.posted.emit)
        self.refresh()
        self._wait()
        self._timer.start()

    def show_frame(self, shown: ShownFrame) -> None:
        self.canvas.show_frame(shown)

    def refresh(self) -> None:
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
            self.panel.chosen.connect(
                lambda name, value: self._handle({"type": "control", "name": name, "value": value})
            )
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
        elif event.isAutoRepeat():
            pass
        elif self.isFullScreen():
            self.showNormal()
        elif command is Command.FULL_SCREEN:
            self.showFullScreen()
        else:
            self.close()

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

    def _call(self, function: Callable[[], None]) -> None:
        function()

    def _handle(self, event: dict[str, object]) -> None:
        self.viewer.handle(event)
        self._wait()

    def _tick(self) -> None:
        if self.viewer.mouse_moves and self.viewer.bench is not None:
            move_mouse(self, self.viewer.bench.gaze(time.perf_counter()))
        self.viewer.tick()
        self._wait()

    def _wait(self) -> None:
        """Has the next tick come in time; starts no timer anew that would come anyway."""
        milliseconds = round(1000 * self.viewer.interval)
        if self._timer.interval() != milliseconds:
            self._timer.setInterval(milliseconds)


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
