"""`hybrid bench endurance`."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import typer

from hybrid.cli.options import (
    Backend,
    FixedSize,
    ForestFile,
    Json,
    SceneName,
    Seed,
    ThinGlass,
    loaded_scene,
    require_size,
    select,
    sized,
    write_json,
)
from hybrid.frame.settings import INTERACTIVE
from hybrid.runtime.progress import progress_bar

# Seconds of the simulated gaze trace.
_TRACE = 60.0
# Rows printed.
_ROWS = 20


def endurance(
    scene: SceneName,
    forest: ForestFile = None,
    size: FixedSize = (640, 480),
    frames: Annotated[int, typer.Option(help="Frames to render.", min=1)] = 20_000,
    thin_glass: ThinGlass = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Follow a gaze trace for many frames, as in the window: does memory grow, or the picture drift?"""
    from compose.eye.saccades import simulated

    require_size(size)
    select(backend)
    from hybrid.bench.endurance import bench_endurance
    from hybrid.frame.live import LiveRenderer
    from hybrid.preparation.quick import forest_for
    from hybrid.runtime.machine import machine

    loaded = loaded_scene(scene, None, thin_glass)
    settings = replace(INTERACTIVE, camera=sized(loaded.camera, size))
    trace = simulated(settings.display, *size, _TRACE, seed)
    renderer = LiveRenderer(loaded, forest_for(loaded, forest))
    with progress_bar("bench") as bar:
        found = bench_endurance(renderer, settings, trace, frames, bar)
    _print(found)
    write_json(json_file, {**found, "machine": machine()})


def _print(found: dict[str, Any]) -> None:
    blocks = found["blocks"]
    print(" frames  seconds  ms per frame  memory, MiB  compiled  drift")
    for block in blocks[:: max(1, -(-len(blocks) // _ROWS))]:
        print(
            f"{block['frames']:7} {block['seconds']:8.0f} {block['milliseconds']:13.1f} "
            f"{block['memory']:12.0f} {block['compiled']:9} {block['drift']:6.2g}"
        )
    print(
        f"after the first minute: {found['memory_growth']:+.2f} MiB per 1,000 frames, "
        f"{found['late_compiled']} kernels compiled, frames {found['slower']:.2f} times as long at the end; "
        f"largest drift {found['drift']:.2g}"
    )
