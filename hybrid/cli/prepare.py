"""`hybrid prepare`: from a scene to a forest, in one job."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar


def prepare(
    scene: o.SceneName,
    forest: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Also write the forest here.")
    ] = None,
    quality: Annotated[str, typer.Option(help="glimpse, draft, standard, high or live.")] = "standard",
    minutes: Annotated[
        float | None, typer.Option(help="Time budget in minutes; overrides --quality.")
    ] = None,
    psnr: Annotated[
        float | None, typer.Option(help="PSNR in dB to reach on held-out views; overrides --quality.")
    ] = None,
    region: o.RegionName = None,
    held_out: Annotated[
        int, o.measurement(help="Held-out validation views; their time is not counted.", max=10_000)
    ] = 4,
    size: o.FixedSize = (256, 256),
    max_depth: o.MaxDepth = None,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    override: o.Override = None,
    clamp_indirect: Annotated[
        float | None,
        o.inputs(
            help="Upper limit on the indirect radiance added to a path of a training frame at once: fewer "
            "fireflies, darker caustics."
        ),
    ] = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
    json_file: o.Json = None,
) -> None:
    """Capture and train in turns, from nothing to a forest; resumes if interrupted."""
    started = time.perf_counter()
    from hybrid.preparation.stages import PreparationSettings

    with o.option_names("quality", "minutes", "psnr", "held_out", most_indirect="clamp-indirect"):
        settings = PreparationSettings(
            region or "near", quality, minutes, psnr, held_out, size, clamp_indirect, seed
        )
    o.require_size(size)
    o.select(backend)
    from hybrid.preparation.decisions import REGION
    from hybrid.preparation.preparation import prepare as run

    o.check_writable(forest)
    loaded = o.planned_scene(scene, max_depth, thin_glass, sensor, override)
    settings = replace(settings, region=region or str(loaded.plan.get(REGION, settings.region)))
    facts = run(loaded, settings, progress_bar, started=started).facts
    if forest is not None:
        shutil.copyfile(facts["forest"], forest)
        facts = {**facts, "forest": str(forest)}
    o.write_json(json_file, facts)
    limit = "" if facts["limit"] is None else f"; limited by {facts['limit']}"
    print(
        f"{facts['gaussians']:,} Gaussians from {facts['views']} views, whose frames have "
        f"{facts['frame_error_db']:.1f} dB, in {facts['seconds']:.0f} s{limit}"
    )
