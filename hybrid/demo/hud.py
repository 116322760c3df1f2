"""The text that the window shows over the frame."""

from __future__ import annotations

import numpy as np

from hybrid.interactive.meter import Meter
from hybrid.interactive.shown import Shown


def lines_of(shown: Shown, meter: Meter) -> list[str]:
    """Lines that tell how long frames take, what was drawn, and with which settings."""
    return [*_times(shown, meter), *_counts(shown), *_settings(shown)]


def _times(shown: Shown, meter: Meter) -> list[str]:
    lines = []
    if meter.intervals:
        p50, p95 = np.percentile([1000 * interval.seconds for interval in meter.intervals], [50, 95])
        lines.append(f"frame {p50:.0f} ms (p95 {p95:.0f}), {1000 / p50:.1f} FPS")
    if meter.latencies:
        latency = np.median([1000 * latency.seconds for latency in meter.latencies])
        lines.append(f"mouse to screen {latency:.0f} ms")
    passes = " ".join(f"{name} {milliseconds:.0f}" for name, milliseconds in shown.milliseconds.items())
    return [*lines, f"{passes} ms"]


def _counts(shown: Shown) -> list[str]:
    lines = [
        f"{shown.paths:,} paths, {shown.frame.nodes_drawn:,} Gaussians",
        f"{shown.spp:.1f} samples per pixel in the disc",
    ]
    if shown.request.view.needs_path_traced:
        lines.append(f"{shown.path_traced_spp} samples per pixel in the path-traced frame")
    return lines


def _settings(shown: Shown) -> list[str]:
    settings, camera = shown.request.settings, shown.frame.camera
    line = f"fov-a {settings.fov_a:.1f} %, fov-b {settings.fov_b:.1f} %, {settings.spp} spp, "
    lines = [line + f"{camera.width} x {camera.height}, {settings.acuity_model}"]
    target_fps = shown.request.target_fps
    if target_fps is not None:
        finest = settings.layers[1] if settings.layers else shown.frame.detail.layers
        side = 1 << settings.rate
        lines.append(
            f"chosen for {target_fps:g} FPS: finest layer {finest}, at most 1 sample per {side} x {side} px"
        )
    return lines
