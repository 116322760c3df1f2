"""One hybrid frame against the full path-traced one, and against its disc alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.mode import FoveaMode
from hybrid.frame.renderer import Renderer
from hybrid.frame.settings import FrameSettings
from hybrid.measure.timing import interleaved, jittered, percentiles
from hybrid.methods.path_traced import FullTrace
from hybrid.sweeps.coverage import covered, reach_for


def compare(
    renderer: Renderer,
    camera: Camera,
    settings: FrameSettings,
    repeats: int,
    warm_up: int,
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    """One row: times of the hybrid frame, of the full path-traced frame, and of the disc alone.

    All three run with kernels compiled and recorded; the full frame is traced by the same function as the
    disc, and denoised if the disc is. The gaze moves only so far that the disc stays in the frame. Each frame
    has a camera of its own, so that it pays for everything it shows.
    """
    full_trace = FullTrace(renderer.tracer, settings.spp, settings.fovea is not FoveaMode.RAW)

    def at(gaze: Gaze, number: int) -> FrameSettings:
        return replace(settings, gaze=gaze, camera=jittered(camera, number))

    def hybrid(gaze: Gaze, seed: int) -> None:
        renderer.frame(at(gaze, 3 * seed), seed)

    def full(gaze: Gaze, seed: int) -> None:
        full_trace.render(jittered(camera, 3 * seed + 1), gaze, seed)

    def disc(gaze: Gaze, seed: int) -> None:
        renderer.disc_alone(at(gaze, 3 * seed + 2), seed)

    methods: dict[str, Callable[[Gaze, int], Any]] = {"hybrid": hybrid, "path_traced": full, "disc": disc}
    reach = reach_for(settings.fov_a, camera)
    times = interleaved(methods, repeats, warm_up, progress, reach)
    row: dict[str, Any] = {f"{name}_ms": percentiles(values) for name, values in times.items()}
    return {
        "width": camera.width,
        "height": camera.height,
        "spp": settings.spp,
        "fov_a": settings.fov_a,
        "fov_b": settings.fov_b,
        **row,
        "ratio": row["path_traced_ms"]["p50"] / row["hybrid_ms"]["p50"],
        "ceiling": row["path_traced_ms"]["p50"] / row["disc_ms"]["p50"],
        "covered": covered(settings.fov_a, camera, repeats, reach),
        "repeats": repeats,
    }
