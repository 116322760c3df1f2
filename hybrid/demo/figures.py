"""Figures of a window in use: frame times, latency, and how well a frame time was kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hybrid.interactive.meter import Meter
from hybrid.measure.timing import percentiles
from hybrid.runtime.machine import machine

# A frame whose time is within this share of the target keeps it.
_TOLERANCE = 0.2
# Seconds after a load within which the target should be kept again.
_RECOVERY = 2.0


def figures(meter: Meter, size: tuple[int, int], start: float) -> dict[str, Any]:
    """Frame times, latencies and passes of a window.

    Args:
        meter: what was measured.
        size: width and height of the frame in pixels.
        start: time.perf_counter from which on frames count.

    Returns:
        `width`, `height`; `fps` and `ms`, median and percentiles of the frame times; `latency_ms`,
        percentiles from mouse to screen; `passes`, median milliseconds of each; `frames`, the seconds from
        the start and the milliseconds of each; `machine`. Absent where nothing was measured.
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
    """How well a frame time was kept.

    Args:
        frames: of each, the seconds at which it came, and the milliseconds since the one before.
        fps: the target.
        loaded: seconds at which another process began and ended to keep a core busy.

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
    if outside:
        found["kept"] = _share_kept(outside, fps)
    if after:
        found["kept_after_load"] = _share_kept(after, fps)
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


def _share_kept(milliseconds: list[float], fps: float) -> float:
    return float(np.mean([abs(ms * fps / 1000 - 1) <= _TOLERANCE for ms in milliseconds]))
