"""Times of the window's frames: collected, shown and summed up; and a bench that measures them."""

from __future__ import annotations

import math
import subprocess
import sys
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np

from compose.eye.gaze import Gaze
from hybrid.base.identity import machine
from hybrid.measure.frame_times import percentiles
from hybrid.window.messages import ShownFrame

# Recent frames whose percentiles are shown while the window runs.
_RECENT = 100


class Meter:
    """Collects the times, of time.perf_counter, of all shown frames or of the last hundred.

    Intervals are from each frame to the next one; latencies from each gaze movement to the first frame that
    includes it or a newer one: pairs of when they ended, when a frame was shown, and how many seconds they
    took. Passes are the milliseconds of each pass, by name, of each frame.
    """

    def __init__(self, keeps_all: bool = False):
        most = None if keeps_all else _RECENT
        self.intervals: deque[tuple[float, float]] = deque(maxlen=most)
        self.latencies: deque[tuple[float, float]] = deque(maxlen=most)
        self.passes: deque[dict[str, float]] = deque(maxlen=most)
        self._movements: deque[float] = deque(maxlen=10 * _RECENT)
        self._last: float | None = None

    def moved(self, gaze_time: float) -> None:
        """Notes that the gaze moved at that time."""
        self._movements.append(gaze_time)

    def pause(self) -> None:
        """Notes that no frames come for a while, for another reason than that they are slow."""
        self._movements.clear()
        self._last = None

    def shown(self, at: float, gaze_time: float, passes: dict[str, float]) -> None:
        """Notes that a frame is on the screen which includes all movements up to `gaze_time`."""
        self.passes.append(passes)
        while self._movements and self._movements[0] <= gaze_time:
            self.latencies.append((at, at - self._movements.popleft()))
        if self._last is not None:
            self.intervals.append((at, at - self._last))
        self._last = at


def lines_of(shown: ShownFrame, meter: Meter) -> list[str]:
    """Lines that tell how long frames take, what was drawn, and with which settings."""
    lines = [shown.notice] if shown.notice else []
    if meter.intervals:
        p50, p95 = np.percentile([1000 * seconds for _, seconds in meter.intervals], [50, 95])
        lines.append(f"frame {p50:.0f} ms (p95 {p95:.0f}), {1000 / p50:.1f} FPS")
    if meter.latencies:
        latency = np.median([1000 * seconds for _, seconds in meter.latencies])
        lines.append(f"mouse to screen {latency:.0f} ms")
    passes = " ".join(f"{name} {milliseconds:.0f}" for name, milliseconds in shown.milliseconds.items())
    lines.append(f"{passes} ms")
    lines.append(f"{shown.paths:,} paths, {shown.frame.nodes_drawn:,} Gaussians")
    lines.append(f"{shown.spp:.1f} samples per pixel in the disc")
    if shown.request.view.needs_path_traced:
        lines.append(f"{shown.path_traced_spp} samples per pixel in the path-traced frame")
    settings, camera = shown.request.settings, shown.frame.camera
    line = f"fov-a {settings.fov_a:.1f} %, fov-b {settings.fov_b:.1f} %, {settings.spp} spp, "
    lines.append(line + f"{camera.width} x {camera.height}, {settings.acuity_model}")
    if shown.request.target_fps is not None:
        finest = settings.layers[1] if settings.layers else shown.frame.detail.layers
        rate = f"at most 1 sample per {1 << settings.rate} x {1 << settings.rate} px"
        lines.append(f"chosen for {shown.request.target_fps:g} FPS: finest layer {finest}, {rate}")
    return lines


# A frame whose time is within this share of the target keeps it.
_TOLERANCE = 0.2
# Seconds after a load within which the target should be kept again.
_RECOVERY = 2.0


def figures(meter: Meter, size: tuple[int, int], start: float) -> dict[str, Any]:
    """Frame times, latencies and passes of a window of that width and height, since a time.perf_counter.

    `width`, `height`; `fps` and `ms`, median and percentiles of the frame times; `latency_ms`, percentiles
    from mouse to screen; `passes`, median milliseconds of each; `frames`, the seconds from the start and the
    milliseconds of each; `machine`. Absent where nothing was measured.
    """
    frames = [(at - start, seconds * 1000) for at, seconds in meter.intervals if at > start]
    latencies = [seconds * 1000 for at, seconds in meter.latencies if at > start]
    found: dict[str, Any] = {"width": size[0], "height": size[1]}
    if frames:
        times = [milliseconds for _, milliseconds in frames]
        found |= {"fps": 1000 / float(np.median(times)), "ms": percentiles(times, (50, 95, 99))}
    if latencies:
        found["latency_ms"] = percentiles(latencies)
    passes = list(meter.passes)[len(meter.passes) - len(frames) :]
    names = dict.fromkeys(name for frame in passes for name in frame)
    medians = {n: float(np.median([frame[n] for frame in passes if n in frame])) for n in names}
    return found | {"passes": medians, "frames": frames, "machine": machine()}


def steadiness(
    frames: Sequence[tuple[float, float]], fps: float, loaded: tuple[float, float] | None
) -> dict[str, Any]:
    """How well a target of frames per second was kept.

    Frames are the seconds at which each came, and the milliseconds since the one before; `loaded` the seconds
    at which another process began and ended to keep a core busy.

    Returns:
        `fps`, `tolerance`; `kept`, the share of frames within 20 % of the target, without those under load
        and in the two seconds after it; `kept_after_load`, the share in those two seconds; `loaded_s` and
        `ms_under_load`, the median under load. Absent where there are no such frames.
    """
    found: dict[str, Any] = {"fps": fps, "tolerance": _TOLERANCE}
    begin, end = loaded or (math.inf, math.inf)
    outside = [ms for at, ms in frames if not begin <= at <= end + _RECOVERY]
    after = [ms for at, ms in frames if end < at <= end + _RECOVERY]
    under_load = [ms for at, ms in frames if begin <= at <= end]
    for name, times in (("kept", outside), ("kept_after_load", after)):
        if times:
            found[name] = float(np.mean([abs(ms * fps / 1000 - 1) <= _TOLERANCE for ms in times]))
    if under_load:
        found |= {"loaded_s": [begin, end], "ms_under_load": float(np.median(under_load))}
    return found


def summary(found: dict[str, Any]) -> str:
    """The figures in one line and, if there was a target, how well it was kept in a second one."""
    if "fps" not in found:
        return "no frame was shown"
    ms, latency = found["ms"], found.get("latency_ms")
    line = f"{found['fps']:.1f} FPS, frames of {ms['p50']:.0f} ms (p95 {ms['p95']:.0f}, p99 {ms['p99']:.0f})"
    if latency:
        line += f", {latency['p50']:.0f} ms from mouse to screen (p95 {latency['p95']:.0f})"
    target = found.get("target", {})
    if "kept" in target:
        line += f"\n{target['kept']:.1%} of frames within {_TOLERANCE:.0%} of {1000 / target['fps']:.0f} ms"
    if "kept_after_load" in target:
        line += f", {target['kept_after_load']:.1%} in the {_RECOVERY:.0f} seconds after the load"
    if "ms_under_load" in target:
        line += f"; {target['ms_under_load']:.0f} ms under load"
    return line


# Seconds before anything counts, in which kernels are compiled.
WARM_UP = 4.0
# Seconds between two movements of the mouse, about as often as mice report them, and for its whole path.
MOVE = 0.008
_ROUND = 8.0
# Where the mouse is at each of them, again and again.
MOUSE_PATH = [
    Gaze(0.5 + 0.3 * math.sin(turn), 0.5 + 0.3 * math.sin(2 * turn))
    for turn in (2 * math.pi * MOVE * step / _ROUND for step in range(round(_ROUND / MOVE)))
]
# A program that keeps a core busy for some seconds; it ends by itself, whatever becomes of the window.
_BUSY = """
import sys, time
end = time.monotonic() + float(sys.argv[1])
while time.monotonic() < end:
    pass
"""


class WindowBench:
    """Measures for `seconds`, after four of warm-up; times are those of time.perf_counter.

    For `load` seconds in the middle, another process keeps one core busy.
    """

    def __init__(self, seconds: float, load: float = 0.0):
        self._seconds, self._load = seconds, load
        self._began = math.inf
        self._busy: subprocess.Popen[bytes] | None = None
        # When the load began, and when it ended.
        self._load_times: list[float] = []

    @property
    def has_begun(self) -> bool:
        """Whether the mouse moves."""
        return self._began < math.inf

    @property
    def start(self) -> float:
        """The time from which on frames count."""
        return self._began + WARM_UP

    @property
    def loaded(self) -> tuple[float, float] | None:
        """Seconds from `start` at which the load began and ended; None if there was none."""
        if len(self._load_times) < 2:
            return None
        begin, end = self._load_times
        return begin - self.start, end - self.start

    def begin(self, now: float) -> None:
        """Begins with the warm-up."""
        self._began = now

    def gaze(self, now: float) -> Gaze:
        """Where the mouse should be."""
        return MOUSE_PATH[int((now - self._began) / MOVE) % len(MOUSE_PATH)]

    def is_over(self, now: float) -> bool:
        """Whether all is measured; starts the load when its time has come, and notes when it ends."""
        since = now - self.start - (self._seconds - self._load) / 2
        if self._busy is None and self._load and since >= 0:
            self._busy = subprocess.Popen([sys.executable, "-c", _BUSY, str(self._load)])
            self._load_times.append(now)
        elif self._busy is not None and len(self._load_times) == 1 and self._busy.poll() is not None:
            self._load_times.append(now)
        return now > self.start + self._seconds
