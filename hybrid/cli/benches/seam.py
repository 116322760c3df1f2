"""`hybrid bench seam`."""

from __future__ import annotations

from hybrid.cli.options import (
    Backend,
    DisplayName,
    ForestArgument,
    FramesFolder,
    Json,
    ReferenceSpp,
    SceneName,
    Spp,
    ThinGlass,
    matching,
    select,
    write_json,
)
from hybrid.frame.settings import FrameSettings
from hybrid.runtime.progress import progress_bar


def seam(
    scene: SceneName,
    frames: FramesFolder,
    forest: ForestArgument,
    display: DisplayName = "desktop",
    spp: Spp = 2,
    reference_spp: ReferenceSpp = 512,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Measure how well the two renderers meet in the band between fov-b and fov-a."""
    settings = FrameSettings(spp=spp, display=display)
    select(backend)
    from hybrid.bench.seam import bench_seam
    from hybrid.measure.metrics.fovvideovdp import INSTALL

    loaded, captured, found = matching(scene, frames, forest, thin_glass)
    with progress_bar("bench (views)") as bar:
        rows = bench_seam(loaded, captured, found, settings, reference_spp, bar)
    print("fovea     inner against outer side   the same by sectors    JOD of the band")
    for row in rows:
        seen = f"{row['jod']:.2f}" if "jod" in row else "-"
        print(f"{row['mode']:<9} {row['difference']:>+25.2%}   {row['sectors']:>19.2%}   {seen:>16}")
    if "jod" not in rows[0]:
        print(INSTALL)
    write_json(json_file, rows)
