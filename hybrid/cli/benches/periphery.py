"""`hybrid bench periphery`."""

from __future__ import annotations

from typing import Any

from hybrid.cli.options import (
    Backend,
    DisplayName,
    ForestFile,
    FovB,
    Json,
    Repeats,
    SceneName,
    ThinGlass,
    WarmUp,
    loaded_scene,
    select,
    write_json,
)
from hybrid.frame.settings import FrameSettings
from hybrid.runtime.progress import progress_bar


def periphery(
    scene: SceneName,
    forest: ForestFile = None,
    display: DisplayName = "desktop",
    fov_b: FovB = 20.0,
    repeats: Repeats = 20,
    warm_up: WarmUp = 5,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time the periphery with each acuity model against full level and rate, and measure its quality."""
    settings = FrameSettings(fov_a=fov_b, fov_b=fov_b, display=display)
    select(backend)
    from hybrid.bench.periphery import bench_periphery, display_camera
    from hybrid.preparation.quick import forest_for
    from hybrid.runtime.machine import machine

    loaded = loaded_scene(scene, None, thin_glass)
    found = forest_for(loaded, forest)
    camera = display_camera(loaded.camera, settings.display)
    with progress_bar("bench (rounds)") as bar:
        rows = bench_periphery(found, camera, settings, repeats, warm_up, bar)
    _print(rows)
    write_json(json_file, [{**row, "scene": loaded.name, "machine": machine()} for row in rows])


def _print(rows: list[dict[str, Any]]) -> None:
    from hybrid.measure.metrics.fovvideovdp import INSTALL

    print("                       camera still       |    moving           |")
    print("gaze     acuity model     ms    full ratio     ms    full ratio   nodes     JOD   SSIM")
    for row in rows:
        quality = "    -" if row["jod"] is None else f"{row['jod']:5.2f}"
        print(
            f"{row['gaze'][0]:.1f} {row['gaze'][1]:.1f}  {row['acuity_model']:<14} "
            f"{row['periphery_ms']['p50']:>5.1f} {row['full_ms']['p50']:>7.1f} {row['ratio']:>5.2f} "
            f"{row['moving_ms']['p50']:>6.1f} {row['moving_full_ms']['p50']:>7.1f} "
            f"{row['moving_ratio']:>5.2f} {row['nodes_drawn']:>7,} {quality:>7} {row['ssim']:.4f}"
        )
    if rows[0]["jod"] is None:
        print(INSTALL)
