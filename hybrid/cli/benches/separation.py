"""`hybrid bench separation`."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from hybrid.cli.options import (
    INPUT,
    MOST_GAUSSIANS,
    Backend,
    FixedSize,
    Json,
    SceneName,
    Seed,
    loaded_scene,
    require_size,
    select,
    user_errors,
    write_json,
)
from hybrid.runtime.progress import progress_bar

# Samples per pixel of frames, which are denoised.
_SPP = 8


def separation(
    scene: SceneName,
    frames: Annotated[
        Path | None,
        typer.Option(
            metavar="FRAMES",
            help="Frame set of the scene; captured for this alone if left out.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    views: Annotated[int, typer.Option(help="Frames that are captured.", min=2, max=1000)] = 64,
    size: FixedSize = (192, 192),
    iterations: Annotated[int, typer.Option(help="Steps of each training.", min=1, max=1_000_000)] = 600,
    gaussians: Annotated[
        int, typer.Option(help="Nodes of the finest layer.", min=1, max=MOST_GAUSSIANS)
    ] = 10_000,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Tell nodes that move from those that stand still, with masks and without; count the right ones."""
    select(backend)
    from hybrid.bench.moving import require_moving
    from hybrid.bench.separation import bench_separation
    from hybrid.frame.irradiance import cache_for
    from hybrid.runtime.machine import machine
    from hybrid.store.identity import require_scene
    from pathtrace.dataset.capture import capture
    from pathtrace.dataset.frames import read_frame_set
    from pathtrace.dataset.settings import CaptureSettings
    from splat.training.trainer import TrainingSettings

    require_size(size)
    loaded = loaded_scene(scene)
    require_moving(loaded)
    with user_errors():
        settings = TrainingSettings(iterations, gaussians, layers=2, degree=0, seed=seed)
        wanted = CaptureSettings(views, 0, *size, spp=_SPP, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        if frames is None:
            cache = cache_for(loaded, progress_bar)
            with progress_bar("capture (samples)") as bar:
                found = capture(loaded, Path(folder), wanted, bar, cache)
        else:
            found = read_frame_set(frames)
            require_scene(found, loaded.name, loaded.hash, frames)
        with progress_bar("bench (steps)") as bar, user_errors():
            rows = bench_separation(loaded, found, settings, bar)
    _print(rows)
    write_json(json_file, {"scene": loaded.name, "rows": rows, "machine": machine()})


def _print(rows: list[dict[str, Any]]) -> None:
    print("motion        labels  precision  recall   nodes  dynamic  objects  pixels: precision  recall")
    for row in rows:
        shares = [
            "      -" if row[name] is None else f"{row[name]:7.3f}"
            for name in ("precision", "recall", "pixel_precision", "pixel_recall")
        ]
        print(
            f"{row['motion']:<12}  {row['labels']:<6}  {shares[0]:>9} {shares[1]:>7}"
            f" {row['nodes']:>7,} {row['dynamic']:>8,}  {row['objects']:>7}  {shares[2]:>17} {shares[3]:>7}"
        )
