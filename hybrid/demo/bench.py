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
        # Before the first frame a forest may be trained, or settings measured.
        window.canvas.painted.connect(self._begin)

    def _begin(self) -> None:
        self._window.canvas.painted.disconnect(self._begin)
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

    @property
    def start(self) -> float:
        """time.perf_counter from which on frames count."""
        return self._began + _WARM_UP


def figures(window: Window, start: float) -> dict[str, Any]:
    """Frame times and latencies of a window from a time on; of each frame also when it came."""
    frames = [(at - start, seconds * 1000) for at, seconds in window.meter.intervals if at > start]
    late = [seconds * 1000 for at, seconds in window.meter.latencies if at > start]
    found: dict[str, Any] = {"width": window.canvas.width(), "height": window.canvas.height()}
    if frames:
        times = [milliseconds for _, milliseconds in frames]
        found |= {"fps": 1000 / float(np.median(times)), "ms": percentiles(times, (50, 95, 99))}
    if late:
        found["latency_ms"] = percentiles(late)
    passes = list(window.meter.passes)[-len(frames) :]
    names = dict.fromkeys(name for frame in passes for name in frame)
    medians = {n: float(np.median([frame[n] for frame in passes if n in frame])) for n in names}
    return found | {"passes": medians, "frames": frames, "machine": machine()}


def summary(found: dict[str, Any]) -> str:
    """The figures in a line."""
    if "fps" not in found:
        return "no frame was shown"
    ms, late = found["ms"], found.get("latency_ms")
    line = f"{found['fps']:.1f} FPS, frames of {ms['p50']:.0f} ms (p95 {ms['p95']:.0f}, p99 {ms['p99']:.0f})"
    return line + (f", {late['p50']:.0f} ms from mouse to screen (p95 {late['p95']:.0f})" if late else "")


def move_mouse(window: Window, gaze: Gaze) -> None:
    """The mouse goes to a point of the frame, without any button."""
    canvas = window.canvas
    at: QPointF = canvas.point_of(gaze)
    none = Qt.MouseButton.NoButton
    event = QMouseEvent(
        QEvent.Type.MouseMove, at, canvas.mapToGlobal(at), none, none, Qt.KeyboardModifier.NoModifier
    )
    QApplication.sendEvent(canvas, event)
