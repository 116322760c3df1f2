"""Runs the window until it is closed; as a bench, with the mouse moving for some seconds."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtCore import QCoreApplication, QEvent, QObject, QPointF, Qt, QTimer
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QApplication

from compose.eye.gaze import Gaze, GazeTrace
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.frame_source import prepared
from hybrid.window.gaze_input import GazeInput
from hybrid.window.main_window import MainWindow, WindowOptions
from hybrid.window.messages import ShownFrame
from hybrid.window.meter import figures, steadiness, summary
from hybrid.window.render_thread import RenderThread

# Seconds before anything counts, in which kernels are compiled.
_WARM_UP = 4.0
# Milliseconds between two movements of the mouse, about as often as mice report them, and seconds for its
# whole path.
_MOVE = 8
_ROUND = 8.0
# A program that keeps a core busy for some seconds; it ends by itself, whatever becomes of the window.
_BUSY = """
import sys, time
end = time.monotonic() + float(sys.argv[1])
while time.monotonic() < end:
    pass
"""


class WindowBench(QObject):
    """Moves the mouse over a window, which is not open yet, for some seconds, then closes it.

    It is measured for `seconds`, after four of warm-up; the mouse does not move if a gaze trace is replayed.
    For `load` seconds in the middle, another process keeps one core busy.
    """

    def __init__(self, window: MainWindow, seconds: float, moves: bool, load: float = 0.0):
        super().__init__(window)
        self._window, self._seconds, self._moves, self._load = window, seconds, moves, load
        self._began = 0.0
        self._busy: subprocess.Popen[bytes] | None = None
        # When the load began, and when it ended.
        self._load_times: list[float] = []
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._step)
        # Not before the first frame: a forest may be trained, or settings measured.
        window.canvas.painted.connect(self._begin)

    def _begin(self, shown: ShownFrame) -> None:
        camera, canvas = shown.request.settings.camera, self._window.canvas
        if camera is None or (camera.width, camera.height) != canvas.pixels:
            # The window has just been laid out; frames of its final size come next.
            return
        canvas.painted.disconnect(self._begin)
        self._began = time.perf_counter()
        self._timer.start(_MOVE)

    def _step(self) -> None:
        passed = time.perf_counter() - self._began
        self._keep_busy(passed - _WARM_UP - (self._seconds - self._load) / 2)
        if passed > _WARM_UP + self._seconds:
            self._timer.stop()
            self._window.close()
        elif self._moves:
            turn = 2 * math.pi * passed / _ROUND
            move_mouse(self._window, Gaze(0.5 + 0.3 * math.sin(turn), 0.5 + 0.3 * math.sin(2 * turn)))

    def _keep_busy(self, since: float) -> None:
        """Runs the other process for its time, `since` seconds after it should begin (negative: before)."""
        if self._busy is None and self._load and since >= 0:
            self._busy = subprocess.Popen([sys.executable, "-c", _BUSY, str(self._load)])
            self._load_times.append(time.perf_counter())
        elif self._busy is not None and len(self._load_times) == 1 and self._busy.poll() is not None:
            self._load_times.append(time.perf_counter())

    @property
    def start(self) -> float:
        """time.perf_counter from which on frames count."""
        return self._began + _WARM_UP

    @property
    def loaded(self) -> tuple[float, float] | None:
        """Seconds from `start` at which the load began and ended; None if there was none."""
        if len(self._load_times) < 2:
            return None
        begin, end = self._load_times
        return begin - self.start, end - self.start


def move_mouse(window: MainWindow, gaze: Gaze) -> None:
    """Moves the mouse to a point of the frame, with no button pressed."""
    canvas = window.canvas
    point: QPointF = canvas.point_of(gaze)
    none = Qt.MouseButton.NoButton
    event = QMouseEvent(
        QEvent.Type.MouseMove, point, canvas.mapToGlobal(point), none, none, Qt.KeyboardModifier.NoModifier
    )
    QCoreApplication.sendEvent(canvas, event)


def run_window(
    scene: str,
    forest: Path | None,
    backend: str,
    settings: FrameSettings,
    trace: GazeTrace | None,
    options: WindowOptions,
    thin_glass: bool = False,
    sensor: str | None = None,
) -> tuple[dict[str, Any], str]:
    """Runs the window until it is closed; arguments are those of commands.

    The trace is replayed instead of the mouse. Returns what was measured (see `figures`; `target`, see
    `steadiness`), and a summary of it for people. UserError if the scene or the forest cannot be used.
    """
    application = QApplication(sys.argv[:1])
    # Training would take minutes of a measurement that is expected to take seconds.
    trains = options.bench is None
    prepare = partial(prepared, scene, forest, backend, trains, settings)
    thread = RenderThread(partial(prepare, thin_glass=thin_glass, sensor=sensor))
    window = MainWindow(thread, settings, GazeInput(options.latency, trace), options)
    bench = None if options.bench is None else WindowBench(window, options.bench, trace is None, options.load)
    window.show()
    # Qt does not notice Ctrl-C by itself.
    signal.signal(signal.SIGINT, lambda number, frame: window.close())
    application.exec()
    if window.error is not None:
        raise window.error
    found = figures(window.meter, window.canvas.pixels, 0.0 if bench is None else bench.start)
    if options.target_fps is not None:
        loaded = None if bench is None else bench.loaded
        found["target"] = steadiness(found["frames"], options.target_fps, loaded)
    return found, summary(found)
