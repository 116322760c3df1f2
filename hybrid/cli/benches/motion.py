"""`hybrid bench motion`."""

from __future__ import annotations

from hybrid.cli.benches.table import metrics
from hybrid.cli.options import (
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
from hybrid.runtime.progress import progress_bar


def motion(
    scene: SceneName,
    frames: FramesFolder,
    forest: ForestArgument,
    reference_spp: ReferenceSpp = 512,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Walk and turn at one sample a frame, and compare the last frame with single ones."""
    select(backend)
    from hybrid.bench.motion import bench_motion

    loaded, captured, found = matching(scene, frames, forest, thin_glass)
    with progress_bar("bench (walks)") as bar:
        rows = bench_motion(loaded, captured, found, reference_spp, bar)
    print("fovea     method                  PSNR    SSIM    FLIP    JOD   pixels without history")
    for row in rows:
        fresh = f"{row['fresh_psnr']:.2f} dB" if "fresh_psnr" in row else "-"
        print(f"{row['mode']:<9} {row['method']:<21} {metrics(row)}  {fresh:>9}")
    write_json(json_file, rows)
