"""`hybrid bench`: commands that measure one part alone."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from compose.base.errors import UserError
from compose.eye.gaze import load_gaze_trace
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import DEFAULTS, INTERACTIVE, FrameSettings


def raster(
    gaussians: Annotated[int, typer.Option(min=1, max=o.MOST_GAUSSIANS)] = 50_000,
    size: o.FixedSize = (512, 512),
    seed: o.Seed = 0,
    repeats: Annotated[int, typer.Option(help="Measured rounds.", min=3, max=o.MOST_FRAMES)] = 50,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Time the rasterizer and its gradient on random Gaussians that are already on the device."""
    o.require_size(size)
    o.select(backend)
    from hybrid.base.identity import machine
    from hybrid.evaluation.splat_bench import bench_raster

    with progress_bar("bench (rounds)") as bar:
        row = bench_raster(gaussians, size, seed, repeats, warm_up=5, progress=bar)
    for name in ("forward", "backward"):
        times = row[f"{name}_ms"]
        print(f"{name}: median {times['p50']:.1f} ms, p95 {times['p95']:.1f} ms")
    print(f"pairs: {row['pairs']:,}")
    return {**row, "machine": machine()}


def integrator(
    scene: o.SceneName,
    size: o.FixedSize = (256, 256),
    reference_spp: o.ReferenceSpp = 1024,
    repeats: o.Repeats = 7,
    max_depth: o.MaxDepth = None,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    override: o.Override = None,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Compare error, time and bias of both integrators on raw frames."""
    o.select(backend)
    from hybrid.base.identity import machine
    from hybrid.evaluation.integrator_bench import bench_integrator

    loaded = o.planned_scene(scene, max_depth, thin_glass, sensor, override)
    with progress_bar("bench (samples)") as bar:
        found = bench_integrator(loaded, o.sized(loaded.camera, size), reference_spp, repeats, bar)
    cache = found["cache"]
    print(f"cache: {cache['cells']:,} cells, {cache['bytes'] / 2**20:.1f} MiB, {cache['seconds']:.1f} s")
    transfer = f"{cache['transfer_bytes'] / 2**20:.1f} MiB"
    print(f"{cache['look_up_ns']:.0f} ns per look-up; {transfer} more to follow lights")
    print("integrator  spp  squared error       ms  efficiency")
    for row in found["rows"]:
        print(
            "{integrator:<10}{spp:>5}{squared_error:>15.4g}{ms[p50]:>9.1f}{efficiency:>12.2f}".format(**row)
        )
    print(f"bias against {reference_spp} spp     mean  worst block  95 % of blocks below")
    for row in found["bias"]:
        print("{integrator:<22}{mean:>+9.2%}{worst_block:>13.1%}{p95_block:>22.1%}".format(**row))
    return {**found, "scene": loaded.name, "machine": machine()}


def periphery(
    scene: o.SceneName,
    forest: o.ForestFile = None,
    display: o.DisplayName = "desktop",
    fov_b: o.FovB = 20.0,
    repeats: o.Repeats = 20,
    warm_up: o.WarmUp = 5,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Time the periphery with each acuity model against full level and rate, and measure its quality."""
    settings = FrameSettings(fov_a=fov_b, fov_b=fov_b, display=display)
    o.select(backend)
    from hybrid.base.identity import machine
    from hybrid.evaluation.splat_bench import bench_periphery, display_camera
    from hybrid.measure.perceptual_metrics import INSTALL
    from hybrid.preparation.preparation import with_forest

    loaded, found = with_forest(o.loaded_scene(scene, None, thin_glass, sensor), forest, progress_bar)
    camera = display_camera(loaded.camera, settings.display)
    with progress_bar("bench (rounds)") as bar:
        rows = bench_periphery(found, camera, settings, repeats, warm_up, bar)
    print("                            camera still       |    moving           |")
    print("gaze     acuity model          ms    full ratio     ms    full ratio   nodes     JOD   SSIM")
    form = (
        "{gaze[0]:.1f} {gaze[1]:.1f}  {acuity_model:<19} {periphery_ms[p50]:>5.1f} {full_ms[p50]:>7.1f} "
        "{ratio:>5.2f} {moving_ms[p50]:>6.1f} {moving_full_ms[p50]:>7.1f} {moving_ratio:>5.2f} "
        "{nodes_drawn:>7,} {quality:>7} {ssim:.4f}"
    )
    for row in rows:
        print(form.format(**row, quality="-" if row["jod"] is None else f"{row['jod']:.2f}"))
    if rows[0]["jod"] is None:
        print(INSTALL)
    return [{**row, "scene": loaded.name, "machine": machine()} for row in rows]


def frame(
    scene: o.SceneName,
    forest: o.ForestFile = None,
    size: Annotated[
        tuple[int, int] | None,
        o.frame(metavar="W H", help="Frame size. Default: both 640 480 and 1920 1080."),
    ] = None,
    fov_a: o.FovA = DEFAULTS.fov_a,
    fov_b: o.FovB = DEFAULTS.fov_b,
    spp: o.Spp = INTERACTIVE.spp,
    repeats: o.Repeats = 15,
    warm_up: o.WarmUp = 5,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Time whole frames in each mode, still and live, while the gaze moves, and count bytes on the host.

    Without --backend, this is done on each available backend in turn.
    """
    sizes = ((640, 480), (1920, 1080)) if size is None else (size,)
    for one in sizes:
        o.require_size(one)
    settings = FrameSettings(fov_a=fov_a, fov_b=fov_b, spp=spp)
    o.select(backend)
    from compose import LLVM
    from hybrid.base.compute_device import device_arrays
    from hybrid.evaluation.frame_bench import bench_frame
    from hybrid.preparation.preparation import with_forest

    loaded, found = with_forest(o.loaded_scene(scene, None, thin_glass, sensor), forest, progress_bar)
    with progress_bar("bench (rounds)") as bar:
        rows = bench_frame(loaded, found, settings, sizes, repeats, warm_up, seed, bar)
    if backend == "auto" and device_arrays().backend == "cuda" and not isinstance(LLVM, UserError):
        rows += on_llvm(sys.argv[1:])
    head = "backend   size       fovea     renderer  wall ms    p95  kernels ms  launches    host bytes  "
    print(head + "longest passes, ms")
    form = (
        "{backend:<8} {width:>5}x{height:<5} {mode:<9} {renderer:<8} {wall_ms[p50]:>8.1f} "
        "{wall_ms[p95]:>6.1f} {kernels_ms:>11.1f} {launches:>9} {host_bytes:>13,}  {longest}"
    )
    for row in rows:
        medians = {name: times["p50"] for name, times in row["passes"].items() if name != "total"}
        first = sorted(medians, key=lambda name: medians[name], reverse=True)[:3]
        longest = ", ".join(f"{name} {medians[name]:.1f}" for name in first)
        print(form.format(**row, renderer="live" if row["live"] else "still", longest=longest))
    return rows


def on_llvm(arguments: list[str]) -> list[dict[str, Any]]:
    """Rows of the same command on LLVM, in a process of its own: a process has one backend.

    What is given twice in the arguments counts as given last. UserError if the process failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.json"
        further = ["--backend", "llvm", "--json", str(file)]
        command = [sys.executable, "-m", "hybrid.cli.main", *arguments, *further]
        code = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode
        if code:
            raise UserError(f"backend llvm: its process ended with exit code {code}; try --backend cuda")
        rows: list[dict[str, Any]] = json.loads(file.read_text())
        return rows


def moving(
    scene: o.SceneName,
    forest: o.ForestFile = None,
    size: o.FixedSize = (320, 240),
    spp: o.Spp = INTERACTIVE.spp,
    reference_spp: o.ReferenceSpp = 128,
    against: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FOREST", help="Forest file to compare with, drawn as splats alone. May be repeated."
        ),
    ] = None,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Play a scene that moves, as in the window, and compare its frames with other methods, by region."""
    o.select(backend)
    from hybrid.base.identity import machine
    from hybrid.evaluation.moving_bench import bench_moving, require_moving
    from hybrid.preparation.preparation import with_forest
    from splat.io.forest_file import load_forest

    loaded = o.loaded_scene(scene, None, thin_glass, sensor)
    require_moving(loaded)
    settings = replace(INTERACTIVE, spp=spp, camera=o.sized(loaded.camera, size))
    loaded, found = with_forest(loaded, forest, progress_bar)
    others = {file.stem: load_forest(file) for file in against or ()}
    with progress_bar("bench (clips)") as bar:
        rows = bench_moving(loaded, found, settings, reference_spp, bar, others)
    names = list(dict.fromkeys(row["region"] for row in rows))
    print(f"{'method':<23}" + "".join(f"{name:>11}" for name in names) + "     ms    p95  ratio")
    by_method: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        by_method.setdefault(row["method"], {})[row["region"]] = row
    for method, own in by_method.items():
        cells = "".join(f"{own[name]['psnr']:8.2f} dB" if name in own else " " * 11 for name in names)
        first = next(iter(own.values()))
        print(f"{method:<23}{cells}{first['ms']['p50']:7.1f}{first['ms']['p95']:7.1f}{first['ratio']:7.2f}")
    for method, own in by_method.items():
        more = [f"{row['jod']:.2f} JOD ({name})" for name, row in own.items() if row.get("jod") is not None]
        shift = own.get("moving", {}).get("registration_px")
        more += [] if shift is None else [f"what moves is off by {shift:.2f} px"]
        if more:
            print(f"{method}: {', '.join(more)}")
    return {"scene": loaded.name, "size": size, "spp": spp, "rows": rows, "machine": machine()}


def _finite(values: list[float]) -> list[float]:
    return [value for value in values if o.finite(value) is not None]


def gaze(
    scene: o.SceneName,
    forest: o.ForestFile = None,
    display: o.DisplayName = "desktop",
    size: Annotated[
        tuple[int, int] | None,
        o.frame("--size", metavar="W H", help="Pixels of the display, as wide in degrees. Default: its own."),
    ] = None,
    gaze_trace: Annotated[
        Path | None, o.viewer(metavar="FILE", help="CSV file with a recorded gaze. Default: simulated.")
    ] = None,
    latency: Annotated[
        list[float],
        o.viewer(
            help="Milliseconds by which methods know the gaze late. May be repeated.",
            min=0,
            max=10_000,
            callback=_finite,
        ),
    ] = [0.0, 50.0, 100.0],  # noqa: B006
    gaze_error: Annotated[
        list[float],
        o.viewer(
            help="Root mean square of the tracker's error in degrees: offset and drift. May be repeated.",
            min=0,
            max=45,
            callback=_finite,
        ),
    ] = [0.0, 1.0, 3.0],  # noqa: B006
    walk: Annotated[
        bool, o.viewer("--walk", help="The camera moves around the scene's own; else it stands still.")
    ] = False,
    both_eyes: Annotated[bool, o.viewer("--both-eyes", help="Judge two videos, one of each eye.")] = False,
    clips: Annotated[int, o.measurement(help="Clips per row.", min=1, max=o.MOST_FRAMES)] = 6,
    seconds: Annotated[float, o.measurement(help="Length of a clip.", min=0.05, max=600)] = 1.0,
    fps: Annotated[int, o.measurement(help="Frames per second.", min=1, max=240)] = 24,
    spp: o.Spp = INTERACTIVE.spp,
    reference_spp: o.ReferenceSpp = 256,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    backend: o.Backend = "auto",
    json_file: o.Json = None,
) -> None:
    """Judge methods as videos for a viewer who looks around while they know the gaze late and inexactly.

    They are judged where the viewer really looks; resumes if interrupted.
    """
    settings = replace(INTERACTIVE, spp=spp, display=display)
    if size is not None:
        o.require_size(size, 4)
        shown = replace(settings.display, width=size[0], height=size[1])
        settings = replace(settings, display=shown)
    trace = None if gaze_trace is None else load_gaze_trace(gaze_trace)
    o.select(backend)
    from hybrid.base.identity import machine
    from hybrid.evaluation.gaze_bench import Clips, bench_gaze
    from hybrid.measure.perceptual_metrics import INSTALL
    from hybrid.preparation.preparation import with_forest

    loaded, found = with_forest(o.loaded_scene(scene, None, thin_glass, sensor), forest, progress_bar)
    more = {
        "display": display,
        "gaze": "simulated" if gaze_trace is None else gaze_trace.stem,
        "scene": loaded.name,
        "machine": machine(),
    }

    def write(rows: list[dict[str, Any]]) -> None:
        o.write_json(json_file, [{**row, **more} for row in rows])

    judged, tracked = Clips(clips, seconds, fps, reference_spp, walk, both_eyes), (latency, gaze_error)
    with progress_bar("bench (videos)") as bar:
        rows = bench_gaze(loaded, found, settings, judged, trace, tracked, write, bar)
    _print_judged(rows)
    if rows[0]["jod"] is None:
        print(INSTALL)


def _print_judged(rows: list[dict[str, Any]]) -> None:
    head = "  late, ms   off, deg     JOD  95 % interval   fovea  95 % interval  flicker       ms"
    print(f"{'method':<22}{head}")
    form = (
        "{method:<22}{latency_ms:>10}{gaze_error_deg:>11}{jod:>8}{low:>8} {high:>6}"
        "{foveal_jod:>8}{foveal_low:>8} {foveal_high:>6}{flicker:>9}{ms:>9}"
    )
    styles = {"latency_ms": "g", "gaze_error_deg": "g", "ms": ".1f"}
    for row in rows:
        cells = {name: "-" if value is None else value for name, value in row.items()}
        numbers = {n: format(v, styles.get(n, ".2f")) for n, v in cells.items() if isinstance(v, float)}
        print(form.format(**cells | numbers))


bench_app = typer.Typer(no_args_is_help=True, help="Measure one part alone.")
for command in (raster, integrator, periphery, frame, moving, gaze):
    bench_app.command()(o.with_json(command))
