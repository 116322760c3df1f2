"""Figures of the window itself, in use."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from typing import Any

import numpy as np
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, QTimer
from PySide6.QtGui import QMouseEvent
from PySide6.QtWidgets import QApplication

from compose.eye.gaze import Gaze
from hybrid.demo.window import Window
from hybrid.interactive.source import Shown
from hybrid.measure.timing import percentiles
from hybrid.runtime.machine import machine

# Seconds before anything counts: kernels are compiled in them.
_WARM_UP = 4.0
# Milliseconds between two movements of the mouse, as mice report them, and seconds for its whole path.
_MOVE = 8
_ROUND = 8.0
# Frames whose time is within so much of the target have kept it.
_TOLERANCE = 0.2
# Seconds after a load within which the target should be kept again.
_RECOVERY = 2.0
# A program that keeps a core busy for some seconds; it ends by itself, whatever becomes of the window.
_BUSY = """
import sys, time
end = time.monotonic() + float(sys.argv[1])
while time.monotonic() < end:
    pass
"""


class WindowBench(QObject):
    """Moves the mouse over a window for some seconds, then closes it.

    Args:
        window: not opened yet.
        seconds: for which it is measured.
        moves: whether the mouse is moved; a gaze trace may be there instead.
        load: seconds in the middle for which another process keeps one core busy.
    """

    def __init__(self, window: Window, seconds: float, moves: bool, load: float = 0.0):
        super().__init__(window)
        self._window, self._seconds, self._moves, self._load = window, seconds, moves, load
        self._began = 0.0
        self._busy: subprocess.Popen[bytes] | None = None
        self._loaded: list[float] = []
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._step)
        # Before the first frame a forest may be trained, or settings measured.
        window.canvas.painted.connect(self._begin)

    def _begin(self, shown: Shown) -> None:
        camera, canvas = shown.request.settings.camera, self._window.canvas
        if camera is None or (camera.width, camera.height) != (canvas.width(), canvas.height()):
            # The window has just been laid out: what a frame of the size that it keeps takes comes next.
            return
        self._window.canvas.painted.disconnect(self._begin)
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
        """Lets the other process run for its time; `since` are seconds from when it is to start."""
        if self._busy is None and self._load and since >= 0:
            self._busy = subprocess.Popen([sys.executable, "-c", _BUSY, str(self._load)])
            self._loaded.append(time.perf_counter())
        elif self._busy is not None and len(self._loaded) == 1 and self._busy.poll() is not None:
            self._loaded.append(time.perf_counter())

    @property
    def start(self) -> float:
        """time.perf_counter from which on frames count."""
        return self._began + _WARM_UP

    @property
    def loaded(self) -> tuple[float, float] | None:
        """Seconds from `start` at which the load began and ended; None if it has not been."""
        if len(self._loaded) < 2:
            return None
        begin, end = self._loaded
        return begin - self.start, end - self.start


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
    passes = list(window.meter.passes)[len(window.meter.passes) - len(frames) :]
    names = dict.fromkeys(name for frame in passes for name in frame)
    medians = {n: float(np.median([frame[n] for frame in passes if n in frame])) for n in names}
    return found | {"passes": medians, "frames": frames, "machine": machine()}


def steadiness(
    frames: list[tuple[float, float]], fps: float, loaded: tuple[float, float] | None
) -> dict[str, Any]:
    """How well a frame time was kept.

    Args:
        frames: when each came, in seconds, and milliseconds since the one before.
        fps: the target.
        loaded: when another process kept a core busy, in seconds.

    Returns:
        `kept`, the share of frames that come within 20 % of the target, those under load and in the two
        seconds after it left out; `kept_after_load`, the share among the latter; `ms_under_load`, the median.
        Absent where there are no such frames.
    """
    found: dict[str, Any] = {"fps": fps, "tolerance": _TOLERANCE}
    begin, end = loaded or (math.inf, math.inf)
    kept = lambda frames: float(np.mean([abs(ms * fps / 1000 - 1) <= _TOLERANCE for ms in frames]))  # noqa: E731
    outside = [ms for at, ms in frames if not begin <= at <= end + _RECOVERY]
    after = [ms for at, ms in frames if end < at <= end + _RECOVERY]
    underlay = [ms for at, ms in frames if begin <= at <= end]
    found |= {"kept": kept(outside)} if outside else {}
    found |= {"kept_after_load": kept(after)} if after else {}
    return found | (
        {"loaded_s": [begin, end], "ms_under_load": float(np.median(underlay))} if underlay else {}
    )


def summary(found: dict[str, Any]) -> str:
    """The figures in a line, and in another how well a target was kept."""
    if "fps" not in found:
        return "no frame was shown"
    ms, late = found["ms"], found.get("latency_ms")
    line = f"{found['fps']:.1f} FPS, frames of {ms['p50']:.0f} ms (p95 {ms['p95']:.0f}, p99 {ms['p99']:.0f})"
    line += f", {late['p50']:.0f} ms from mouse to screen (p95 {late['p95']:.0f})" if late else ""
    target = found.get("target", {})
    if "kept" in target:
        line += f"\n{target['kept']:.1%} of frames within {_TOLERANCE:.0%} of {1000 / target['fps']:.0f} ms"
    if "ms_under_load" in target:
        line += f", outside of the load, under which they take {target['ms_under_load']:.0f} ms"
    if "kept_after_load" in target:
        line += f", and the {_RECOVERY:.0f} seconds after it, in which {target['kept_after_load']:.1%} are"
    return line


def move_mouse(window: Window, gaze: Gaze) -> None:
    """The mouse goes to a point of the frame, without any button."""
    canvas = window.canvas
    at: QPointF = canvas.point_of(gaze)
    none = Qt.MouseButton.NoButton
    event = QMouseEvent(
        QEvent.Type.MouseMove, at, canvas.mapToGlobal(at), none, none, Qt.KeyboardModifier.NoModifier
    )
    QApplication.sendEvent(canvas, event)
