"""`hybrid bench still`."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import typer

from compose.eye.gaze_trace import MOST_SECONDS
from hybrid.cli.options import (
    Backend,
    FixedSize,
    ForestFile,
    Gaze,
    Json,
    ReferenceSpp,
    SceneName,
    ThinGlass,
    finite,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.frame.settings import INTERACTIVE, FrameSettings
from hybrid.runtime.progress import progress_bar


def still(
    scene: SceneName,
    forest: ForestFile = None,
    size: FixedSize = (640, 480),
    gaze: Gaze = None,
    seconds: Annotated[
        float,
        typer.Option(help="Time for which nothing moves.", min=1, max=MOST_SECONDS, callback=finite),
    ] = 20.0,
    reference_spp: ReferenceSpp = 1024,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Keep everything still, as in the window, and measure how the disc improves from frame to frame."""
    from compose.eye.gaze import require_within_frame

    at = FrameSettings(gaze or INTERACTIVE.gaze).gaze
    require_within_frame(at.x, at.y)
    select(backend)
    from hybrid.bench.still import bench_still
    from hybrid.frame.live import LiveRenderer
    from hybrid.preparation.quick import forest_for
    from hybrid.runtime.machine import machine

    loaded = loaded_scene(scene, None, thin_glass)
    settings = replace(INTERACTIVE, gaze=at, camera=sized(loaded.camera, size))
    renderer = LiveRenderer(loaded, forest_for(loaded, forest))
    with progress_bar("bench (seconds)") as bar:
        found = bench_still(renderer, settings, seconds, reference_spp, bar)
    _print(found, seconds)
    write_json(json_file, {**found, "machine": machine()})


def _print(found: dict[str, Any], seconds: float) -> None:
    print("seconds    samples per pixel     PSNR")
    for until in [0, *(t for t in (1, 2, 5, 10, 20, 50, 100) if t <= seconds)]:
        last = [row for row in found["frames"] if row["seconds"] <= until] or found["frames"][:1]
        print(f"{last[-1]['seconds']:7.1f} {last[-1]['spp']:20.0f} {last[-1]['psnr']:8.2f} dB")
    print(f"the reference itself: {found['reference_psnr']:.2f} dB")
    print(f"worse than a frame before, after the first second: by {found['most_fall']:.2f} dB at most")
