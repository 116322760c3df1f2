"""One hybrid frame against the full path-traced one, and against its disc alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from hybrid.frame.renderer import HybridRenderer
from hybrid.measure.timing import interleaved, jittered, percentiles
from hybrid.sweeps.coverage import covered, reach_for
from pathtrace.trace.film import frame_positions


def compare(
    renderer: HybridRenderer,
    camera: Camera,
    fov_a: float,
    fov_b: float,
    spp: int,
    repeats: int,
    warm_up: int,
    progress: Callable[[int, int], None],
) -> dict[str, Any]:
    """One row: times of the hybrid frame, of the full path-traced frame and of the disc alone.

    All three run with kernels compiled and recorded; the full frame is traced by the same function as
    the disc, and denoised where the disc is. The gaze moves only so far that the disc stays in the frame.
    Each frame has a camera of its own, so that each pays for all that it shows.
    """
    frame = frame_positions(camera)

    def hybrid(gaze: Gaze, seed: int) -> None:
        renderer.frame(jittered(camera, 3 * seed), Foveation(gaze, fov_a, fov_b), spp, seed)

    def full(gaze: Gaze, seed: int) -> None:
        renderer.path_traced(jittered(camera, 3 * seed + 1), frame, spp, seed)

    def disc(gaze: Gaze, seed: int) -> None:
        region = Foveation(gaze, fov_a, fov_b).region(camera.width, camera.height)
        renderer.disc_alone(jittered(camera, 3 * seed + 2), region, spp, seed)

    methods: dict[str, Callable[[Gaze, int], Any]] = {"hybrid": hybrid, "path_traced": full, "disc": disc}
    reach = reach_for(fov_a, camera)
    times = interleaved(methods, repeats, warm_up, progress, reach)
    row: dict[str, Any] = {f"{name}_ms": percentiles(values) for name, values in times.items()}
    return {
        "width": camera.width,
        "height": camera.height,
        "spp": spp,
        "fov_a": fov_a,
        "fov_b": fov_b,
        **row,
        "ratio": row["path_traced_ms"]["p50"] / row["hybrid_ms"]["p50"],
        "ceiling": row["path_traced_ms"]["p50"] / row["disc_ms"]["p50"],
        "covered": covered(fov_a, camera, repeats, reach),
        "repeats": repeats,
    }
