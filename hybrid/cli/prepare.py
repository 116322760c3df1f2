"""`hybrid prepare`: from a scene to a forest, in one job."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from hybrid.cli.options import (
    INPUT,
    MEASUREMENT,
    Backend,
    FixedSize,
    Json,
    MaxDepth,
    RegionName,
    SceneName,
    Seed,
    ThinGlass,
    option_names,
    planned_scene,
    require_size,
    select,
    write_json,
)
from hybrid.cli.progress import progress_bar

_MOST_VIEWS = 10_000


def prepare(
    scene: SceneName,
    forest: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Also write the forest here.")
    ] = None,
    quality: Annotated[str, typer.Option(help="draft, standard or high: how far to go.")] = "standard",
    minutes: Annotated[float | None, typer.Option(help="Time to use instead.")] = None,
    psnr: Annotated[float | None, typer.Option(help="dB on held-out views to reach instead.")] = None,
    region: RegionName = None,
    held_out: Annotated[
        int,
        typer.Option(
            help="Views that judge; their time is not counted.", max=_MOST_VIEWS, rich_help_panel=MEASUREMENT
        ),
    ] = 4,
    size: FixedSize = (256, 256),
    max_depth: MaxDepth = None,
    thin_glass: ThinGlass = False,
    clamp_indirect: Annotated[
        float | None,
        typer.Option(
            help="Most radiance that indirect light adds to a path of a training frame at once: fewer "
            "fireflies, darker caustics.",
            rich_help_panel=INPUT,
        ),
    ] = None,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Capture and train in turns, from nothing to a forest; resumes if interrupted."""
    started = time.perf_counter()
    from hybrid.preparation.stages import PreparationSettings

    with option_names("quality", "minutes", "psnr", "held_out", most_indirect="clamp-indirect"):
        settings = PreparationSettings(
            region or "near", quality, minutes, psnr, held_out, size, clamp_indirect, seed
        )
    require_size(size)
    select(backend)
    from hybrid.preparation.decisions import REGION
    from hybrid.preparation.preparation import prepare as run
    from hybrid.render.image_files import check_writable

    if forest is not None:
        check_writable(forest)
    loaded = planned_scene(scene, max_depth, thin_glass)
    settings = replace(settings, region=region or str(loaded.plan.get(REGION, settings.region)))
    prepared = run(loaded, settings, progress_bar, started=started)
    facts = prepared.facts
    if forest is not None:
        shutil.copyfile(facts["forest"], forest)
        facts = {**facts, "forest": str(forest)}
    write_json(json_file, facts)
    print(
        f"{facts['gaussians']:,} Gaussians from {facts['views']} views, whose frames have "
        f"{facts['frame_error_db']:.1f} dB, in {facts['seconds']:.0f} s"
    )
