"""`hybrid bench change`."""

from __future__ import annotations

from functools import partial

from hybrid.cli.benches.table import metrics
from hybrid.cli.options import (
    Backend,
    ForestArgument,
    FramesFolder,
    Json,
    ReferenceSpp,
    SceneName,
    Spp,
    ThinGlass,
    loaded_scene,
    matching,
    select,
    write_json,
)
from hybrid.runtime.progress import progress_bar


def change(
    scene: SceneName,
    frames: FramesFolder,
    forest: ForestArgument,
    spp: Spp = 16,
    reference_spp: ReferenceSpp = 512,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Change the scene after training, and measure whether the fused fovea shows the changed scene."""
    select(backend)
    from hybrid.bench.change import bench_change

    _, captured, found = matching(scene, frames, forest, thin_glass)
    with progress_bar("bench (frames)") as bar:
        rows = bench_change(partial(loaded_scene, scene), captured, found, spp, reference_spp, bar)
    print("change            method        PSNR    SSIM    FLIP    JOD")
    for row in rows:
        print(f"{row['change']:<16}  {row['method']:<11} {metrics(row)}")
    write_json(json_file, rows)
