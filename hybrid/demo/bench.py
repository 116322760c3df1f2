"""Figures of the window itself, in use."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, QTimer
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QApplication

from compose.view import Gaze
from hybrid.demo.window import Window
from hybrid.timing import machine, percentiles

# Seconds before anything counts: kernels are compiled in them.
_WARM_UP = 4.0
# Milliseconds between two movements of the mouse, as mice report them, and seconds for its whole path.
_MOVE = 8
_ROUND = 8.0


class WindowBench(QObject):
    """Moves the mouse over a window for some seconds, then closes it.

    Args:
        window: not opened yet.
        seconds: for which it is measured.
        moves: whether the mouse is moved; a gaze trace may be there instead.
    """

    def __init__(self, window: Window, seconds: float, moves: bool):
        super().__init__(window)
        self._window, self._seconds, self._moves = window, seconds, moves
        self._began = 0.0
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._step)
        window.opened.connect(self._begin)

    def _begin(self) -> None:
        self._began = time.perf_counter()
        self._timer.start(_MOVE)

    def _step(self) -> None:
        passed = time.perf_counter() - self._began
        if passed > _WARM_UP + self._seconds:
            self._timer.stop()
            self._window.close()
        elif self._moves:
            turn = 2 * math.pi * passed / _ROUND
            move_mouse(self._window, Gaze(0.5 + 0.3 * math.sin(turn), 0.5 + 0.3 * math.sin(2 * turn)))

    def result(self) -> dict[str, Any]:
        """Frame times, latencies and the machine; seconds count from the end of the warm-up."""
        start = self._began + _WARM_UP
        meter, canvas = self._window.meter, self._window.canvas
        frames = [(at - start, seconds * 1000) for at, seconds in meter.intervals if at > start]
        times = [milliseconds for _, milliseconds in frames]
        # Events of the warm-up come first.
        late = [1000 * seconds for seconds in meter.latencies][-round(self._seconds * 1000 / _MOVE) :]
        if not times or not late:
            return {"machine": machine()}
        return {
            "width": canvas.width(),
            "height": canvas.height(),
            "seconds": self._seconds,
            "fps": 1000 / float(np.median(times)),
            "ms": percentiles(times, (50, 95, 99)),
            "latency_ms": percentiles(late, (50, 95)),
            "frames": frames,
            "machine": machine(),
        }


def move_mouse(window: Window, gaze: Gaze) -> None:
    """The mouse goes to a point of the frame, without any button."""
    canvas = window.canvas
    at: QPointF = canvas.point_of(gaze)
    none = Qt.MouseButton.NoButton
    event = QMouseEvent(
        QEvent.Type.MouseMove, at, canvas.mapToGlobal(at), none, none, Qt.KeyboardModifier.NoModifier
    )
    QApplication.sendEvent(canvas, event)
