"""`hybrid bench`: commands that measure one part alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from compose.base.errors import UserError
from hybrid.cli.options import (
    Backend,
    DisplayName,
    ForestFile,
    FovA,
    FovB,
    GazeAt,
    Json,
    SceneName,
    Seed,
    Size,
    Spp,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.runtime.progress import progress_bar

if TYPE_CHECKING:
    from pathtrace.dataset.frames import FrameSet
    from pathtrace.scene.scene import Scene
    from splat.model.forest import Forest

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
    from hybrid.bench.raster import bench_raster as run
    from hybrid.runtime.device import device_arrays
    from hybrid.runtime.machine import machine

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
    repeats: Annotated[int, typer.Option(help="Measured passes per acuity model and gaze.", min=3)] = 20,
    warm_up: Annotated[int, typer.Option(help="Passes before that.", min=1)] = 5,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time the periphery under each acuity model against full level and full rate, with the quality it keeps."""
    from compose.eye.display import display_named
    from compose.eye.gaze import Gaze
    from compose.fovea.region import Foveation

    Foveation(Gaze(), fov_b, fov_b)
    shown = display_named(display)
    select(backend)
    from hybrid.bench.periphery import bench_periphery as run
    from hybrid.bench.periphery import display_camera
    from hybrid.measure.metrics.fovvideovdp import INSTALL
    from hybrid.runtime.device import device_arrays
    from hybrid.runtime.machine import machine
    from hybrid.training.quick import forest_for

    loaded = loaded_scene(scene)
    found = forest_for(loaded, forest)
    view = display_camera(loaded.camera, shown)
    with progress_bar("bench (rounds)") as bar:
        rows = run(device_arrays(), found, view, shown, fov_b, repeats, warm_up, bar)
    print("                       camera still       |    moving           |")
    print("gaze     acuity model              ms    full ratio     ms    full ratio   nodes     JOD   SSIM")
    for row in rows:
        quality = "    -" if row["jod"] is None else f"{row['jod']:5.2f}"
        print(
            f"{row['gaze'][0]:.1f} {row['gaze'][1]:.1f}  {row['acuity_model']:<14} {row['periphery_ms']['p50']:>5.1f} "
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
    from hybrid.bench.forest import bench_forest as run
    from hybrid.runtime.device import device_arrays
    from hybrid.runtime.machine import machine

    row = run(nodes, seed, device_arrays().backend)
    print(f"layers of {', '.join(f'{count:,}' for count in row['layers'])} nodes")
    print(f"grown in {row['build_s']:.1f} s, loaded in {row['load_s']:.1f} s")
    print(f"peak memory of loading and rendering: {row['peak_bytes'] / 1e9:.2f} GB")
    write_json(json_file, {**row, "machine": machine()})


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
    from compose.eye.display import display_named
    from compose.eye.gaze import Gaze
    from compose.fovea.region import Foveation

    Foveation(Gaze(), fov_b, fov_b)
    shown = display_named(display)
    if span < step:
        raise UserError(f"--span {span}: must be at least one --step, {step}")
    select(backend)
    from hybrid.bench.gaze import bench_gaze as run
    from hybrid.bench.gaze import gazes_across
    from hybrid.bench.periphery import display_camera
    from hybrid.runtime.device import device_arrays
    from hybrid.runtime.machine import machine
    from hybrid.training.quick import forest_for

    path = gazes_across(shown, fov_b, step, span)
    loaded = loaded_scene(scene)
    found = forest_for(loaded, forest)
    view = display_camera(loaded.camera, shown)
    with progress_bar("bench (frames)") as bar:
        rows = run(device_arrays(), found, view, shown, fov_b, path, bar)
    print("change per step, in 1/255   99.9th percentile   largest")
    for row in rows:
        print(f"{row['acuity_model']:<27} {row['change_p99_9']:>17.2f} {row['change_max']:>9.2f}")
    settings = {"step_degrees": step, "span_degrees": span, "scene": loaded.name, "machine": machine()}
    write_json(json_file, [{**row, **settings} for row in rows])


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
    from compose.eye.display import display_named
    from compose.eye.gaze import Gaze
    from compose.fovea.region import Foveation

    Foveation(Gaze(), fov_b, fov_b)
    shown = display_named(display)
    select(backend)
    from hybrid.bench.held_out import bench_held_out as run
    from hybrid.measure.metrics.fovvideovdp import INSTALL
    from hybrid.runtime.device import device_arrays
    from hybrid.store.identity import require_scene
    from pathtrace.dataset.frames import read_frame_set
    from splat.io.forest_file import load_forest

    captured, found = read_frame_set(frames), load_forest(forest)
    require_scene(found, captured.scene_name, captured.scene_hash, forest)
    with progress_bar("bench (frames)") as bar:
        rows = run(device_arrays(), captured, found, shown, fov_b, bar)
    print("law               JOD  lowest    PSNR    SSIM")
    for row in rows:
        jods = "    -       -" if row["jod"] is None else f"{row['jod']:5.2f}  {row['lowest_jod']:6.2f}"
        print(f"{row['acuity_model']:<14}  {jods}  {row['psnr']:6.2f}  {row['ssim']:.4f}")
    if rows[0]["jod"] is None:
        print(INSTALL)
    write_json(json_file, rows)


@bench_app.command("passes")
def bench_passes(
    scene: SceneName,
    forest: ForestFile = None,
    size: Size = None,
    fov_a: FovA = 20.0,
    fov_b: FovB = 15.0,
    spp: Spp = 2,
    repeats: Annotated[int, typer.Option(help="Measured frames per mode.", min=3)] = 15,
    warm_up: Annotated[int, typer.Option(help="Frames before that.", min=1)] = 3,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time each pass of a frame with a raw, a denoised and a fused fovea, interleaved."""
    from compose.eye.gaze import Gaze
    from compose.fovea.region import Foveation

    Foveation(Gaze(), fov_a, fov_b)
    select(backend)
    from hybrid.bench.passes import bench_passes as run
    from hybrid.runtime.machine import machine
    from hybrid.training.quick import forest_for

    loaded = loaded_scene(scene)
    camera, found = sized(loaded.camera, size), forest_for(loaded, forest)
    with progress_bar("bench (rounds)") as bar:
        rows = run(loaded, found, camera, (fov_a, fov_b), spp, repeats, warm_up, bar)
    names = list(rows[0]["passes"])
    print("fovea    " + "".join(f"{name:>8}" for name in names) + "   made / traced  over raw   (median ms)")
    for row in rows:
        times = "".join(f"{row['passes'][name]['p50']:>8.1f}" for name in names)
        print(f"{row['mode']:<9}{times}   {row['share_of_tracing']:>13.1%} {row['over_raw']:>9.1%}")
    write_json(json_file, [{**row, "scene": loaded.name, "machine": machine()} for row in rows])


FramesFolder = Annotated[Path, typer.Argument(metavar="FRAMES", help="Folder of the scene's frame set.")]
ForestArgument = Annotated[Path, typer.Argument(metavar="FOREST", help="Trained on that frame set.")]
SppList = Annotated[
    list[int] | None, typer.Option(help="Samples per pixel; may be given several times.", min=1)
]
Seeds = Annotated[int, typer.Option(help="Runs of each.", min=1)]
ReferenceSpp = Annotated[int, typer.Option(help="Samples per pixel of the references.", min=4)]


@bench_app.command("fusion")
def bench_fusion(
    scene: SceneName,
    frames: FramesFolder,
    forest: ForestArgument,
    spp: SppList = None,
    scale: Annotated[
        list[int] | None,
        typer.Option(help="Resolution over that of the frame set; may be given several times.", min=1, max=8),
    ] = None,
    seeds: Seeds = 2,
    reference_spp: ReferenceSpp = 1024,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Compare the fused fovea with each of its parents, on views that nothing was fitted to."""
    select(backend)
    from hybrid.bench.fusion import bench_fusion as run
    from hybrid.runtime.device import device_arrays

    counts, scales = tuple(spp or (1, 2, 4, 16, 64)), tuple(scale or (1, 2))
    loaded, captured, found = _belonging(scene, frames, forest)
    with progress_bar("bench (crops)") as bar:
        rows = run(device_arrays(), loaded, captured, found, counts, scales, seeds, reference_spp, bar)
    print("scale   spp  method        PSNR    SSIM    FLIP   reference")
    for row in rows:
        print(
            f"{row['scale']:>4}x {row['spp']:>5}  {row['method']:<11} {_metrics(row)}  "
            f"{row['reference_psnr']:>6.1f} dB"
        )
    write_json(json_file, rows)


@bench_app.command("change")
def bench_change(
    scene: SceneName,
    frames: FramesFolder,
    forest: ForestArgument,
    spp: Annotated[int, typer.Option(help="Samples per pixel in the fovea.", min=1)] = 16,
    reference_spp: ReferenceSpp = 512,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Change the scene after training, and see whether the fused fovea shows what is there."""
    select(backend)
    from hybrid.bench.change import bench_change as run
    from hybrid.runtime.device import device_arrays

    _, captured, found = _belonging(scene, frames, forest)
    load = lambda: loaded_scene(scene)  # noqa: E731
    with progress_bar("bench (pictures)") as bar:
        rows = run(device_arrays(), load, captured, found, spp, reference_spp, bar)
    print("change            method        PSNR    SSIM    FLIP")
    for row in rows:
        print(f"{row['change']:<16}  {row['method']:<11} {_metrics(row)}")
    write_json(json_file, rows)


@bench_app.command("motion")
def bench_motion(
    scene: SceneName,
    frames: FramesFolder,
    forest: ForestArgument,
    reference_spp: ReferenceSpp = 512,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Walk and turn at one sample a frame, and compare the last frame with single ones."""
    select(backend)
    from hybrid.bench.motion import bench_motion as run
    from hybrid.runtime.device import device_arrays

    loaded, captured, found = _belonging(scene, frames, forest)
    with progress_bar("bench (walks)") as bar:
        rows = run(device_arrays(), loaded, captured, found, reference_spp, bar)
    print("fovea     method                  PSNR    SSIM    FLIP   where nothing was seen before")
    for row in rows:
        fresh = f"{row['fresh_psnr']:.2f} dB" if "fresh_psnr" in row else "-"
        print(f"{row['mode']:<9} {row['method']:<21} {_metrics(row)}  {fresh:>9}")
    write_json(json_file, rows)


@bench_app.command("seam")
def bench_seam(
    scene: SceneName,
    frames: FramesFolder,
    forest: ForestArgument,
    display: DisplayName = "desktop",
    spp: Annotated[int, typer.Option(help="Samples per pixel in the fovea.", min=1)] = 2,
    reference_spp: ReferenceSpp = 512,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """See how well the two renderers meet in the band between fov-b and fov-a."""
    from compose.eye.display import display_named

    shown = display_named(display)
    select(backend)
    from hybrid.bench.seam import bench_seam as run
    from hybrid.measure.metrics.fovvideovdp import INSTALL

    loaded, captured, found = _belonging(scene, frames, forest)
    with progress_bar("bench (views)") as bar:
        rows = run(loaded, captured, found, shown, spp, reference_spp, bar)
    print("fovea     inner against outer side   the same by sectors    JOD of the band")
    for row in rows:
        seen = f"{row['jod']:.2f}" if "jod" in row else "-"
        print(f"{row['mode']:<9} {row['difference']:>+25.2%}   {row['sectors']:>19.2%}   {seen:>16}")
    if "jod" not in rows[0]:
        print(INSTALL)
    write_json(json_file, rows)


@bench_app.command("still")
def bench_still(
    scene: SceneName,
    forest: ForestFile = None,
    size: Annotated[tuple[int, int], typer.Option(metavar="W H")] = (640, 480),
    gaze: GazeAt = (0.5, 0.5),
    seconds: Annotated[float, typer.Option(help="For which nothing moves.", min=1)] = 20.0,
    reference_spp: ReferenceSpp = 1024,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Keep everything still, as in the window, and see how the disc gets better from frame to frame."""
    from compose.eye.gaze import Gaze, require_within_frame

    require_within_frame(*gaze)
    select(backend)
    from hybrid.bench.still import bench_still as run
    from hybrid.frame.live import LiveRenderer
    from hybrid.frame.periphery import Viewing
    from hybrid.runtime.machine import machine
    from hybrid.training.quick import forest_for

    loaded = loaded_scene(scene)
    renderer = LiveRenderer(loaded, forest_for(loaded, forest), Viewing())
    with progress_bar("bench (seconds)") as bar:
        found = run(renderer, sized(loaded.camera, size), Gaze(*gaze), seconds, reference_spp, bar)
    print("seconds    samples per pixel     PSNR")
    for until in [0, *(t for t in (1, 2, 5, 10, 20, 50, 100) if t <= seconds)]:
        last = [row for row in found["frames"] if row["seconds"] <= until] or found["frames"][:1]
        print(f"{last[-1]['seconds']:7.1f} {last[-1]['spp']:20.0f} {last[-1]['psnr']:8.2f} dB")
    print(f"the reference itself: {found['reference_psnr']:.2f} dB")
    print(f"worse than a frame before, after the first second: by {found['most_fall']:.2f} dB at most")
    write_json(json_file, {**found, "machine": machine()})


def _belonging(scene: str, frames: Path, forest: Path) -> tuple[Scene, FrameSet, Forest]:
    """A scene, its frame set and its forest; refuses those of another scene."""
    from hybrid.store.identity import require_scene
    from pathtrace.dataset.frames import read_frame_set
    from splat.io.forest_file import load_forest

    captured, found = read_frame_set(frames), load_forest(forest)
    loaded = loaded_scene(scene)
    require_scene(captured, loaded.name, loaded.hash, frames)
    require_scene(found, loaded.name, loaded.hash, forest)
    return loaded, captured, found


def _metrics(row: dict[str, Any]) -> str:
    flip = f"{row['flip']:.4f}" if "flip" in row else "     -"
    return f"{row['psnr']:6.2f}  {row['ssim']:.4f}  {flip}"
