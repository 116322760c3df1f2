"""`hybrid bench fusion`."""

from __future__ import annotations

from typing import Annotated

import typer

from hybrid.cli.benches.table import metrics
from hybrid.cli.options import (
    MEASUREMENT,
    Backend,
    ForestArgument,
    FramesFolder,
    Json,
    ReferenceSpp,
    SceneName,
    ThinGlass,
    matching,
    select,
    write_json,
)
from hybrid.frame.settings import MOST_SPP
from hybrid.runtime.progress import progress_bar


def fusion(
    scene: SceneName,
    frames: FramesFolder,
    forest: ForestArgument,
    spp: Annotated[
        list[int] | None,
        typer.Option(help="Samples per pixel; may be given several times.", min=1, max=MOST_SPP),
    ] = None,
    scale: Annotated[
        list[int] | None,
        typer.Option(help="Resolution over that of the frame set; may be given several times.", min=1, max=8),
    ] = None,
    seeds: Annotated[
        int, typer.Option(help="Runs of each.", min=1, max=1000, rich_help_panel=MEASUREMENT)
    ] = 2,
    reference_spp: ReferenceSpp = 1024,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Compare the fused fovea with each of its parents, on views that nothing was fitted to."""
    select(backend)
    from hybrid.bench.fusion import FusionEffort, bench_fusion

    effort = FusionEffort(tuple(spp or (1, 2, 4, 16, 64)), tuple(scale or (1, 2)), seeds, reference_spp)
    loaded, captured, found = matching(scene, frames, forest, thin_glass)
    with progress_bar("bench (crops)") as bar:
        rows = bench_fusion(loaded, captured, found, effort, bar)
    print("scale   spp  method           PSNR    SSIM    FLIP    JOD   reference")
    for row in rows:
        cells = f"{row['scale']:>4}x {row['spp']:>5}  {row['method']:<14} {metrics(row)}"
        print(f"{cells}  {row['reference_psnr']:>6.1f} dB")
    write_json(json_file, rows)
