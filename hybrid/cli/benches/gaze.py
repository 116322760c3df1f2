"""`hybrid bench gaze`."""

from __future__ import annotations

from typing import Annotated

import typer

from compose.base.errors import UserError
from hybrid.cli.options import (
    Backend,
    DisplayName,
    ForestFile,
    FovB,
    Json,
    SceneName,
    ThinGlass,
    finite,
    loaded_scene,
    select,
    write_json,
)
from hybrid.frame.settings import FrameSettings
from hybrid.runtime.progress import progress_bar


def gaze(
    scene: SceneName,
    forest: ForestFile = None,
    display: DisplayName = "desktop",
    fov_b: FovB = 20.0,
    step: Annotated[
        float, typer.Option(help="Degrees between two frames.", min=0.01, max=160, callback=finite)
    ] = 0.1,
    span: Annotated[
        float,
        typer.Option(help="Degrees from the first frame to the last.", min=0.1, max=160, callback=finite),
    ] = 20.0,
    thin_glass: ThinGlass = False,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Move the gaze in small steps and measure how much the periphery changes from frame to frame."""
    settings = FrameSettings(fov_a=fov_b, fov_b=fov_b, display=display)
    if span < step:
        raise UserError(f"--span {span}: must be at least one --step, {step}")
    select(backend)
    from hybrid.bench.gaze import bench_gaze, gazes_across
    from hybrid.bench.periphery import display_camera
    from hybrid.preparation.quick import forest_for
    from hybrid.runtime.machine import machine

    path = gazes_across(settings.display, fov_b, step, span)
    loaded = loaded_scene(scene, None, thin_glass)
    found = forest_for(loaded, forest)
    camera = display_camera(loaded.camera, settings.display)
    with progress_bar("bench (frames)") as bar:
        rows = bench_gaze(found, camera, settings, path, bar)
    print("change per step, in 1/255   99.9th percentile   largest")
    for row in rows:
        print(f"{row['acuity_model']:<27} {row['change_p99_9']:>17.2f} {row['change_max']:>9.2f}")
    common = {"step_degrees": step, "span_degrees": span, "scene": loaded.name, "machine": machine()}
    write_json(json_file, [{**row, **common} for row in rows])
