"""`hybrid bench`: commands that measure one part alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from compose.errors import UserError
from hybrid.options import (
    Backend,
    DisplayName,
    ForestFile,
    FovB,
    Json,
    SceneName,
    Seed,
    loaded_scene,
    select,
    write_json,
)
from hybrid.progress import progress_bar

bench_app = typer.Typer(no_args_is_help=True, help="Measure one part alone.")


@bench_app.command("raster")
def bench_raster(
    gaussians: Annotated[int, typer.Option(min=1)] = 50_000,
    size: Annotated[tuple[int, int], typer.Option(metavar="W H")] = (512, 512),
    seed: Seed = 0,
    repeats: Annotated[int, typer.Option(help="Measured rounds.", min=3)] = 50,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time the rasterizer and its gradient on random Gaussians that are already on the device."""
    if min(size) <= 0:
        raise UserError(f"--size {size[0]} {size[1]}: must be positive")
    select(backend)
    from hybrid.bench import bench_raster as run
    from hybrid.device import device_arrays
    from hybrid.timing import machine

    with progress_bar("bench (rounds)") as bar:
        row = run(device_arrays(), gaussians, size[0], size[1], seed, repeats, 5, bar)
    for name in ("forward", "backward"):
        times = row[f"{name}_ms"]
        print(f"{name}: median {times['p50']:.1f} ms, p95 {times['p95']:.1f} ms")
    print(f"pairs: {row['pairs']:,}")
    write_json(json_file, {**row, "machine": machine()})


@bench_app.command("periphery")
def bench_periphery(
    scene: SceneName,
    forest: ForestFile = None,
    display: DisplayName = "desktop",
    fov_b: FovB = 20.0,
    repeats: Annotated[int, typer.Option(help="Measured passes per law and gaze.", min=3)] = 20,
    warm_up: Annotated[int, typer.Option(help="Passes before that.", min=1)] = 5,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time the periphery under each law against full level and full rate, with the quality it keeps."""
    from compose.foveation import Foveation
    from compose.view import Gaze, display_named

    Foveation(Gaze(), fov_b, fov_b)
    shown = display_named(display)
    select(backend)
    from hybrid.bench_periphery import bench_periphery as run
    from hybrid.bench_periphery import display_camera
    from hybrid.cache import forest_for
    from hybrid.device import device_arrays
    from hybrid.fovvideovdp import INSTALL
    from hybrid.timing import machine

    loaded = loaded_scene(scene)
    found = forest_for(loaded, forest)
    view = display_camera(loaded.camera, shown)
    with progress_bar("bench (rounds)") as bar:
        rows = run(device_arrays(), found, view, shown, fov_b, repeats, warm_up, bar)
    print("                       camera still       |    moving           |")
    print("gaze     law              ms    full ratio     ms    full ratio   nodes     JOD   SSIM")
    for row in rows:
        quality = "    -" if row["jod"] is None else f"{row['jod']:5.2f}"
        print(
            f"{row['gaze'][0]:.1f} {row['gaze'][1]:.1f}  {row['law']:<14} {row['periphery_ms']['p50']:>5.1f} "
            f"{row['full_ms']['p50']:>7.1f} {row['ratio']:>5.2f} {row['moving_ms']['p50']:>6.1f} "
            f"{row['moving_full_ms']['p50']:>7.1f} {row['moving_ratio']:>5.2f} {row['nodes_drawn']:>7,} "
            f"{quality:>7} {row['ssim']:.4f}"
        )
    if rows[0]["jod"] is None:
        print(INSTALL)
    write_json(json_file, [{**row, "scene": loaded.name, "machine": machine()} for row in rows])


@bench_app.command("forest")
def bench_forest(
    nodes: Annotated[int, typer.Option(help="Gaussians of the finest layer.", min=1)] = 1_000_000,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Grow a forest over random Gaussians, load it again, and see what memory rendering takes."""
    select(backend)
    from hybrid.bench_forest import bench_forest as run
    from hybrid.device import device_arrays
    from hybrid.timing import machine

    row = run(nodes, seed, device_arrays().backend)
    write_json(json_file, {**row, "machine": machine()})
    print(f"layers of {', '.join(f'{count:,}' for count in row['layers'])} nodes")
    print(f"grown in {row['build_s']:.1f} s, loaded in {row['load_s']:.1f} s")
    print(f"peak memory of loading and rendering: {row['peak_bytes'] / 1e9:.2f} GB")


@bench_app.command("gaze")
def bench_gaze(
    scene: SceneName,
    forest: ForestFile = None,
    display: DisplayName = "desktop",
    fov_b: FovB = 20.0,
    step: Annotated[float, typer.Option(help="Degrees between two frames.", min=0.01)] = 0.1,
    span: Annotated[float, typer.Option(help="Degrees from the first frame to the last.", min=0.1)] = 20.0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Move the gaze in small steps and see how much the periphery changes from each to the next."""
    from compose.foveation import Foveation
    from compose.view import Gaze, display_named

    Foveation(Gaze(), fov_b, fov_b)
    shown = display_named(display)
    if span < step:
        raise UserError(f"--span {span}: must be at least one --step, {step}")
    select(backend)
    from hybrid.bench_gaze import bench_gaze as run
    from hybrid.bench_periphery import display_camera
    from hybrid.cache import forest_for
    from hybrid.device import device_arrays
    from hybrid.timing import machine

    loaded = loaded_scene(scene)
    found = forest_for(loaded, forest)
    view = display_camera(loaded.camera, shown)
    with progress_bar("bench (frames)") as bar:
        rows = run(device_arrays(), found, view, shown, fov_b, step, span, bar)
    print("change per step, in 1/255   99.9th percentile   largest")
    for row in rows:
        print(f"{row['law']:<27} {row['change_p99_9']:>17.2f} {row['change_max']:>9.2f}")
    write_json(json_file, [{**row, "scene": loaded.name, "machine": machine()} for row in rows])


@bench_app.command("held-out")
def bench_held_out(
    frames: Annotated[Path, typer.Argument(metavar="FRAMES", help="Folder of a frame set.")],
    forest: Annotated[Path, typer.Argument(metavar="FOREST", help="Trained on the other frames of the set.")],
    display: DisplayName = "desktop",
    fov_b: FovB = 20.0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Put the forest's periphery into converged held-out frames and see what a viewer would notice."""
    from compose.foveation import Foveation
    from compose.view import Gaze, display_named

    Foveation(Gaze(), fov_b, fov_b)
    shown = display_named(display)
    select(backend)
    from hybrid.bench_held_out import bench_held_out as run
    from hybrid.device import device_arrays
    from hybrid.fovvideovdp import INSTALL
    from pathtrace.frames import read_frame_set
    from splat.files import load_forest

    with progress_bar("bench (frames)") as bar:
        rows = run(device_arrays(), read_frame_set(frames), load_forest(forest), shown, fov_b, bar)
    print("law               JOD  lowest    PSNR    SSIM")
    for row in rows:
        jods = "    -       -" if row["jod"] is None else f"{row['jod']:5.2f}  {row['lowest_jod']:6.2f}"
        print(f"{row['law']:<14}  {jods}  {row['psnr']:6.2f}  {row['ssim']:.4f}")
    if rows[0]["jod"] is None:
        print(INSTALL)
    write_json(json_file, rows)
