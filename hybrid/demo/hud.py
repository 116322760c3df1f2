"""The text that the window shows over the frame."""

from __future__ import annotations

import numpy as np

from hybrid.interactive.meter import Meter
from hybrid.interactive.request import View
from hybrid.interactive.source import Shown

HELP = [
    "mouse             the gaze follows it",
    "drag, arrows      look around",
    "W A S D Q E       walk; Q down, E up",
    "space             hold the gaze where it is",
    "R                 back to the scene's own camera",
    *(f"{number}                 {view.value}" for number, view in enumerate(View, 1)),
    "P                 picture of the frame, as PNG and EXR",
    "T                 record the gaze; again: save it as CSV",
    "G                 ring around the disc",
    "H                 frame times",
    "Tab               controls",
    "F                 full screen",
    "F1                this help",
    "Esc               leave full screen, or the window",
]


def lines_of(shown: Shown, meter: Meter) -> list[str]:
    """Lines with frame times, and with what was drawn and how."""
    settings, frame = shown.request.settings, shown.frame
    intervals = np.array([seconds for _, seconds in meter.intervals]) * 1000
    lines = []
    if len(intervals):
        p50, p95 = np.percentile(intervals, [50, 95])
        lines.append(f"frame {p50:.0f} ms (p95 {p95:.0f}), {1000 / p50:.1f} FPS")
    if meter.latencies:
        lines.append(
            f"mouse to screen {1000 * np.median([seconds for _, seconds in meter.latencies]):.0f} ms"
        )
    lines.append(" ".join(f"{name} {value:.0f}" for name, value in shown.milliseconds.items()) + " ms")
    lines.append(f"{shown.paths:,} paths, {frame.nodes_drawn:,} Gaussians")
    lines.append(f"{shown.spp:.1f} samples per pixel in the disc so far")
    if shown.request.view.needs_path_traced:
        lines.append(f"{shown.reference_spp} in the path-traced frame")
    camera, target_fps = frame.camera, shown.request.target_fps
    chosen = f"fov-a {settings.fov_a:.1f} %, fov-b {settings.fov_b:.1f} %, {settings.spp} spp, "
    lines.append(chosen + f"{camera.width} x {camera.height}, {settings.acuity_model}")
    if target_fps is not None:
        finest = settings.layers[1] if settings.layers else len(frame.detail.steps)
        lines.append(f"chosen for {target_fps:g} FPS: layers to {finest}, rate {1 << settings.rate}")
    return lines
