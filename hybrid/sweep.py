"""Hybrid frames against full path tracing over resolutions (Foveated Path Culling, Table 4 in kind)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from compose.foveation import Foveation
from compose.view import Camera, Gaze
from hybrid.renderer import HybridRenderer
from hybrid.timing import interleaved, percentiles
from pathtrace.film import frame_positions

RESOLUTIONS = ((800, 600), (1012, 1061), (1954, 1061), (3316, 1061))


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
    the disc, and denoised where the disc is.
    """
    frame = frame_positions(camera)

    def hybrid(gaze: Gaze, seed: int) -> None:
        renderer.frame(camera, Foveation(gaze, fov_a, fov_b), spp, seed)

    def full(gaze: Gaze, seed: int) -> None:
        renderer.path_traced(camera, frame, spp, seed)

    def disc(gaze: Gaze, seed: int) -> None:
        plan = Foveation(gaze, fov_a, fov_b).plan(camera.width, camera.height)
        renderer.disc_alone(camera, plan, spp, seed)

    times = interleaved({"hybrid": hybrid, "path_traced": full, "disc": disc}, repeats, warm_up, progress)
    row = {f"{name}_ms": percentiles(values) for name, values in times.items()}
    return {
        "width": camera.width,
        "height": camera.height,
        "spp": spp,
        "fov_a": fov_a,
        "fov_b": fov_b,
        **row,
        "ratio": row["path_traced_ms"]["p50"] / row["hybrid_ms"]["p50"],
        "ceiling": row["path_traced_ms"]["p50"] / row["disc_ms"]["p50"],
        "repeats": repeats,
    }


def resolution_rows(
    renderer: HybridRenderer,
    camera: Camera,
    fov_a: float,
    fov_b: float,
    spp: int,
    repeats: int,
    warm_up: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """One row per resolution; a wider frame sees more of the scene."""
    rows = []
    rounds = (repeats + warm_up) * len(RESOLUTIONS)
    for index, (width, height) in enumerate(RESOLUTIONS):
        before = index * (repeats + warm_up)
        advance = lambda done, total, before=before: progress(before + done, rounds)  # noqa: E731
        rows.append(
            {
                "scene": renderer.tracer.scene.name,
                **compare(
                    renderer, camera.resized(width, height), fov_a, fov_b, spp, repeats, warm_up, advance
                ),
            }
        )
    return rows
