"""`hybrid bench held-out`."""

from __future__ import annotations

from hybrid.cli.options import (
    Backend,
    DisplayName,
    ForestArgument,
    FovB,
    FramesFolder,
    Json,
    select,
    write_json,
)
from hybrid.frame.settings import FrameSettings
from hybrid.runtime.progress import progress_bar


def held_out(
    frames: FramesFolder,
    forest: ForestArgument,
    display: DisplayName = "desktop",
    fov_b: FovB = 20.0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Put the forest's periphery into converged held-out frames and measure what a viewer would notice."""
    settings = FrameSettings(fov_a=fov_b, fov_b=fov_b, display=display)
    select(backend)
    from hybrid.bench.held_out import bench_held_out
    from hybrid.measure.metrics.fovvideovdp import INSTALL
    from hybrid.store.identity import require_scene
    from pathtrace.dataset.frames import read_frame_set
    from splat.io.forest_file import load_forest

    captured, found = read_frame_set(frames), load_forest(forest)
    require_scene(found, captured.scene_name, captured.scene_hash, forest)
    with progress_bar("bench (frames)") as bar:
        rows = bench_held_out(captured, found, settings, bar)
    print("acuity model      JOD  lowest    PSNR    SSIM")
    for row in rows:
        jods = "    -       -" if row["jod"] is None else f"{row['jod']:5.2f}  {row['lowest_jod']:6.2f}"
        print(f"{row['acuity_model']:<14}  {jods}  {row['psnr']:6.2f}  {row['ssim']:.4f}")
    if rows[0]["jod"] is None:
        print(INSTALL)
    write_json(json_file, rows)
