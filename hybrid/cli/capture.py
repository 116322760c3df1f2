"""`hybrid capture`: renders training frames."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from hybrid.cli.options import (
    FRAME,
    MEASUREMENT,
    Backend,
    FixedSize,
    FramesFolder,
    Json,
    MaxDepth,
    SceneName,
    Seed,
    ThinGlass,
    planned_scene,
    require_size,
    select,
    user_errors,
    write_json,
)
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import MOST_SPP
from pathtrace.trace.integrator import Integrator, integrator_named

_MOST_VIEWS = 100_000


def capture(
    scene: SceneName,
    frames: FramesFolder,
    views: Annotated[int, typer.Option(help="Training views.", max=_MOST_VIEWS, rich_help_panel=FRAME)] = 64,
    held_out: Annotated[
        int,
        typer.Option(
            help="Further views: splats are fitted to none, the fusion to two of three.",
            max=_MOST_VIEWS,
            rich_help_panel=MEASUREMENT,
        ),
    ] = 8,
    size: FixedSize = (256, 256),
    spp: Annotated[
        int | None,
        typer.Option(
            help="Samples per pixel of a training view; as planned for the scene if left out.",
            min=1,
            max=MOST_SPP,
            rich_help_panel=FRAME,
        ),
    ] = None,
    held_out_spp: Annotated[
        int,
        typer.Option(help="Samples per pixel of a held-out view.", max=MOST_SPP, rich_help_panel=MEASUREMENT),
    ] = 256,
    integrator: Annotated[
        str,
        typer.Option(
            help="Of training views: path, or cached (quicker). Held-out views are unbiased.",
            rich_help_panel=FRAME,
        ),
    ] = Integrator.CACHED.value,
    monocular: Annotated[
        bool,
        typer.Option(
            "--monocular",
            help="One camera that sways around the scene's own, one instant after the other, as in a video.",
            rich_help_panel=FRAME,
        ),
    ] = False,
    max_depth: MaxDepth = None,
    thin_glass: ThinGlass = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Render training frames; resumes if interrupted."""
    select(backend)
    from hybrid.base.cache_folder import keep_receipt
    from hybrid.preparation.decisions import FIXED_SAMPLES, SAMPLES
    from hybrid.render.irradiance import cache_for
    from pathtrace.dataset.capture import capture as run
    from pathtrace.dataset.frame_set import CaptureSettings

    with user_errors():
        settings = CaptureSettings(
            views, held_out, *size, spp or FIXED_SAMPLES, held_out_spp, seed=seed, monocular=monocular
        )
    require_size(size)
    is_cached = integrator_named(integrator) is Integrator.CACHED
    start = time.perf_counter()
    loaded = planned_scene(scene, max_depth, thin_glass)
    settings = replace(settings, spp=spp or loaded.plan.get(SAMPLES, FIXED_SAMPLES))
    cache = cache_for(loaded, progress_bar) if is_cached else None
    with progress_bar("capture (samples)") as bar:
        found = run(loaded, Path(frames), settings, bar, cache)
    keep_receipt(found)
    row = {
        "scene": found.scene_name,
        "views": len(found.training),
        "held_out": len(found.held_out),
        "width": size[0],
        "height": size[1],
        "spp": settings.spp,
        "integrator": found.integrator,
        "seconds": time.perf_counter() - start,
    }
    write_json(json_file, row)
    print(f"{row['views']} training views and {row['held_out']} held-out views in {frames}")
