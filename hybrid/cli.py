"""The commands: thin, each checks what the user gave, calls one function and prints what came out.

Mitsuba, torch and everything that needs them are imported inside the commands, so that `--help` answers
at once and a missing package or LLVM is a line, not a traceback.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from compose.acuity import DEFAULT_LAW
from compose.errors import UserError
from compose.files import write_whole
from hybrid.progress import progress_bar

if TYPE_CHECKING:
    from compose.view import Camera
    from pathtrace.scene import Scene

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Path-traced fovea, Gaussian-splat periphery: one scene, two renderers, one frame.",
)
bench_app = typer.Typer(no_args_is_help=True, help="Measure one part alone.")
app.add_typer(bench_app, name="bench")

SceneName = Annotated[
    str, typer.Argument(metavar="SCENE", help="A bundled scene's name or a Mitsuba XML file.")
]
Backend = Annotated[str, typer.Option(help="auto, cuda or llvm.")]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write what was measured.")]
Seed = Annotated[int, typer.Option(help="Same seed, same result on the same machine.", min=0)]
ForestFile = Annotated[
    Path | None, typer.Option("--forest", metavar="FOREST", help="Default: the newest one of the scene.")
]
FovA = Annotated[
    float, typer.Option("--fov-a", help="Radius of the path-traced disc, percent of the height.")
]
FovB = Annotated[float, typer.Option("--fov-b", help="Radius inside of which no splats are drawn, percent.")]
Law = Annotated[
    str,
    typer.Option(
        help="What the eye resolves: geisler-perry, stelacsf, fov-gs, or none for full detail everywhere."
    ),
]
Layers = Annotated[
    tuple[int, int] | None,
    typer.Option(metavar="LOW HIGH", help="Coarsest and finest layer that may be drawn; 1 is the coarsest."),
]
DisplayName = Annotated[
    str, typer.Option(metavar="NAME", help="desktop, hmd, or a JSON file with width, height and fov.")
]
Spp = Annotated[int, typer.Option("--spp", help="Samples per pixel in the disc.", min=1)]


@app.command()
def doctor(backend: Backend = "auto", json_file: Json = None) -> None:
    """Say which backend runs, why, and what to install where something is missing."""
    from hybrid.doctor import examine

    report = examine(backend)
    for line in report.lines():
        print(line)
    _write_json(json_file, report.facts)
    if report.problem:
        raise UserError(report.problem)


@app.command()
def scenes(backend: Backend = "auto", json_file: Json = None) -> None:
    """List the bundled scenes and their facts."""
    _select(backend)
    from hybrid.cache import newest_forest
    from pathtrace.scene import bundled_scenes, load_scene
    from splat.files import load_forest

    rows = []
    for name, path in bundled_scenes().items():
        scene = load_scene(name)
        forest = newest_forest(scene)
        counts = load_forest(forest).counts if forest else ()
        rows.append(
            {
                "scene": name,
                "triangles": scene.triangles,
                "emitters": len(scene.mitsuba.emitters()),
                "max_depth": scene.max_depth,
                "width": scene.camera.width,
                "height": scene.camera.height,
                "file": str(path),
                "forest": str(forest) if forest else None,
                "nodes_per_layer": list(counts),
                "trees": counts[0] if counts else 0,
            }
        )
        nodes = " + ".join(f"{count:,}" for count in counts)
        print(
            f"{name}: {scene.triangles:,} triangles, {rows[-1]['emitters']} emitters, "
            f"depth {scene.max_depth}, {scene.camera.width} x {scene.camera.height}, "
            + (
                f"forest {forest}: {counts[0]:,} trees, layers of {nodes} nodes"
                if counts
                else "no forest yet"
            )
        )
    _write_json(json_file, rows)


@app.command()
def quickstart(
    scene: Annotated[str, typer.Argument(metavar="[SCENE]")] = "room",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where pictures, page and numbers go.")] = Path(
        "out"
    ),
    fov_a: FovA = 20.0,
    fov_b: FovB = 15.0,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """The main job, from nothing to pictures and numbers."""
    _select(backend)
    from compose.foveation import Foveation
    from compose.view import Gaze
    from hybrid.images import check_writable
    from hybrid.quickstart import quickstart as run

    Foveation(Gaze(), fov_a, fov_b)  # refuses bad radii before the long work begins
    check_writable(out / "result.json")
    result = run(_scene(scene), out, fov_a, fov_b, seed)
    _write_json(out / "result.json", result)
    _write_json(json_file, result)
    print(
        f"hybrid {result['hybrid']['psnr']:.2f} dB, splats {result['splat']['psnr']:.2f} dB, "
        f"{result['ratio']:.2f} x faster than full path tracing, {result['seconds']['total']:.0f} s in all"
    )
    print(f"Open {out / 'index.html'}")


@app.command()
def capture(
    scene: SceneName,
    frames: Annotated[Path, typer.Argument(metavar="FRAMES", help="Folder of the frame set.")],
    views: Annotated[int, typer.Option(help="Training views.")] = 64,
    held_out: Annotated[int, typer.Option(help="Views that training never sees.")] = 8,
    size: Annotated[tuple[int, int], typer.Option(metavar="W H", help="Frame size.")] = (256, 256),
    spp: Annotated[int, typer.Option(help="Samples per pixel of a training view.")] = 32,
    held_out_spp: Annotated[int, typer.Option(help="Samples per pixel of a held-out view.")] = 256,
    max_depth: Annotated[int | None, typer.Option(help="Path depth; default: the scene's.", min=1)] = None,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Render training frames; an interrupted capture goes on where it stopped."""
    _select(backend)
    import time

    from pathtrace.capture import CaptureSettings
    from pathtrace.capture import capture as run

    settings = _checked(
        CaptureSettings,
        views=views,
        held_out=held_out,
        width=size[0],
        height=size[1],
        spp=spp,
        held_out_spp=held_out_spp,
        seed=seed,
    )
    start = time.perf_counter()
    with progress_bar("capture (samples)") as bar:
        found = run(_scene(scene, max_depth), frames, settings, bar)
    row = {
        "scene": found.scene_name,
        "views": len(found.training),
        "held_out": len(found.held_out),
        "width": size[0],
        "height": size[1],
        "spp": spp,
        "seconds": time.perf_counter() - start,
    }
    _write_json(json_file, row)
    print(f"{row['views']} training views and {row['held_out']} held-out views in {frames}")


@app.command()
def train(
    frames: Annotated[Path, typer.Argument(metavar="FRAMES", help="Folder of a frame set.")],
    forest: Annotated[Path, typer.Argument(metavar="FOREST", help="File to write.")],
    iterations: Annotated[int, typer.Option(help="Optimizer steps, over all layers.")] = 3000,
    gaussians: Annotated[int, typer.Option(help="How many the finest layer has in the end.")] = 40_000,
    layers: Annotated[int, typer.Option(help="Layers of the forest; 1 for Gaussians without trees.")] = 4,
    degree: Annotated[int, typer.Option(help="Degree of the spherical harmonics, 0 to 3.")] = 2,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Train a forest on a frame set; an interrupted training goes on from its checkpoint."""
    _select(backend)
    from hybrid.cache import remember_forest
    from hybrid.device import device_arrays
    from hybrid.images import check_writable
    from hybrid.training import held_out_quality, train_forest
    from pathtrace.frames import read_frame_set
    from splat.train import TrainingSettings

    settings = _checked(
        TrainingSettings,
        iterations=iterations,
        gaussians=gaussians,
        layers=layers,
        degree=degree,
        seed=seed,
    )
    found = read_frame_set(frames)
    check_writable(forest)
    arrays = device_arrays()
    with progress_bar("train (steps)") as bar:
        trained, seconds = train_forest(arrays, found, forest, settings, bar)
    remember_forest(trained, forest.stem)
    measured = held_out_quality(arrays, found, trained)
    row = {
        "scene": found.scene_name,
        "layers": measured,
        "trees": trained.counts[0],
        "iterations": iterations,
        "seconds": seconds,
    }
    _write_json(json_file, row)
    print(f"{sum(trained.counts):,} nodes in {trained.counts[0]:,} trees in {seconds:.0f} s")
    for layer in measured:
        print(
            f"layer {layer['layer']}: {layer['nodes']:,} nodes"
            + (f", held-out views {layer['psnr']:.2f} dB, SSIM {layer['ssim']:.4f}" if found.held_out else "")
        )


@app.command()
def render(
    scene: SceneName,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="A .exr or .png file.")],
    forest: ForestFile = None,
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="JSON with the names of transforms.json.")
    ] = None,
    gaze: Annotated[tuple[float, float], typer.Option(metavar="X Y", help="Fractions of the frame.")] = (
        0.5,
        0.5,
    ),
    fov_a: FovA = 20.0,
    fov_b: FovB = 15.0,
    spp: Spp = 4,
    size: Annotated[tuple[int, int] | None, typer.Option(metavar="W H", help="Default: the scene's.")] = None,
    fovea: Annotated[
        str, typer.Option(help="raw: what Mitsuba gives, unbiased; denoised: OIDN.")
    ] = "denoised",
    law: Law = DEFAULT_LAW,
    layers: Layers = None,
    display: DisplayName = "desktop",
    detail: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Also a PNG that shows level, rate and eccentricity."),
    ] = None,
    max_depth: Annotated[int | None, typer.Option(help="Path depth; default: the scene's.", min=1)] = None,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Render one hybrid frame: EXR with all layers in linear radiance, or PNG in sRGB."""
    from compose.acuity import law_named
    from compose.foveation import Foveation
    from compose.view import Gaze, display_named
    from hybrid.images import check_writable, write_bytes, write_layers, write_png

    if output.suffix.lower() not in (".exr", ".png"):
        raise UserError(f"--output {output}: must end in .exr or .png")
    if fovea not in ("raw", "denoised"):
        raise UserError(f"--fovea {fovea}: must be raw or denoised")
    if detail is not None and detail.suffix.lower() != ".png":
        raise UserError(f"--detail {detail}: must end in .png")
    foveation = Foveation(_checked(Gaze, x=gaze[0], y=gaze[1]), fov_a, fov_b)
    law_named(law)
    shown = display_named(display)
    for file in (output, detail):
        if file is not None:
            check_writable(file)
    _select(backend)
    from hybrid.cache import forest_for
    from hybrid.detail_picture import detail_picture
    from hybrid.layers import frame_layers
    from hybrid.periphery import Viewing
    from hybrid.renderer import HybridRenderer

    loaded = _scene(scene, max_depth)
    view = _view(loaded, camera, size)
    viewing = Viewing(shown, law, layers)
    renderer = HybridRenderer(loaded, forest_for(loaded, forest), viewing, denoised=fovea == "denoised")
    frame = renderer.frame(view, foveation, spp, seed)
    if output.suffix.lower() == ".exr":
        write_layers(output, frame_layers(renderer, view, foveation.gaze, frame))
    else:
        write_png(output, frame.composite)
    if detail is not None:
        write_bytes(detail, detail_picture(frame.composite, frame.detail, frame.plan))
    _write_json(
        json_file,
        {
            "scene": loaded.name,
            "width": view.width,
            "height": view.height,
            "spp": spp,
            "fov_a": fov_a,
            "fov_b": fov_b,
            "fovea": fovea,
            "law": law,
            "pixels_per_degree": shown.pixels_per_degree,
            "nodes_drawn": frame.nodes_drawn,
            "milliseconds": frame.milliseconds,
        },
    )
    print(f"{output}: {view.width} x {view.height}, {frame.milliseconds['total']:.0f} ms")


@app.command("export")
def export_command(
    forest: Annotated[Path, typer.Argument(metavar="FOREST")],
    output: Annotated[Path, typer.Argument(metavar="out.ply")],
    layer: Annotated[
        int | None, typer.Option(help="1, the coarsest, to L; default: L.", show_default=False)
    ] = None,
) -> None:
    """Write one layer of a forest as a PLY file that other viewers of 3D Gaussian splatting open."""
    from splat.files import export_ply, load_forest

    layers = load_forest(forest).layers
    number = len(layers) if layer is None else layer
    if not 1 <= number <= len(layers):
        raise UserError(f"--layer {layer}: {forest} has layers 1 to {len(layers)}")
    gaussians = layers[number - 1].gaussians
    export_ply(output, gaussians)
    print(f"{output}: layer {number}, {len(gaussians):,} Gaussians, degree {gaussians.degree}")


@app.command("import")
def import_command(
    source: Annotated[Path, typer.Argument(metavar="in.ply")],
    forest: Annotated[Path, typer.Argument(metavar="FOREST")],
) -> None:
    """Read a PLY file of 3D Gaussian splatting; the forest is bound to no scene."""
    from splat.files import UNBOUND_FOCAL, import_ply, save_forest
    from splat.forest import forest_of, static_layer

    gaussians = import_ply(source)
    save_forest(forest, forest_of([static_layer(gaussians)], UNBOUND_FOCAL, source.stem, ""))
    print(f"{forest}: {len(gaussians):,} Gaussians, degree {gaussians.degree}")


@app.command()
def sweep(
    scene: SceneName,
    over: Annotated[str, typer.Option(help="What varies: resolution.")] = "resolution",
    forest: ForestFile = None,
    fov_a: FovA = 20.0,
    fov_b: FovB = 15.0,
    spp: Spp = 1,
    repeats: Annotated[int, typer.Option(help="Measured frames per method and row.", min=3)] = 15,
    warm_up: Annotated[int, typer.Option(help="Frames before that.", min=1)] = 2,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Time hybrid frames against full path tracing, interleaved, with a raw fovea."""
    if over != "resolution":
        raise UserError(f"--over {over}: must be resolution")
    _select(backend)
    from compose.foveation import Foveation
    from compose.view import Gaze
    from hybrid.cache import forest_for
    from hybrid.renderer import HybridRenderer
    from hybrid.sweep import resolution_rows
    from hybrid.timing import machine

    Foveation(Gaze(), fov_a, fov_b)
    loaded = _scene(scene)
    renderer = HybridRenderer(loaded, forest_for(loaded, forest))
    with progress_bar("sweep (rounds)") as bar:
        rows = resolution_rows(renderer, loaded.camera, fov_a, fov_b, spp, repeats, warm_up, bar)
    print("   size       hybrid    full     disc   ratio  ceiling   (median ms)")
    for row in rows:
        hybrid_ms, full, disc = (row[f"{name}_ms"]["p50"] for name in ("hybrid", "path_traced", "disc"))
        print(
            f"{row['width']:>5}x{row['height']:<5} {hybrid_ms:>8.0f} {full:>8.0f} {disc:>8.0f} "
            f"{row['ratio']:>7.2f} {row['ceiling']:>7.2f}"
        )
    _write_json(json_file, [{**row, "machine": machine()} for row in rows])


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
    _select(backend)
    from hybrid.bench import bench_raster as run
    from hybrid.device import device_arrays
    from hybrid.timing import machine

    with progress_bar("bench (rounds)") as bar:
        row = run(device_arrays(), gaussians, size[0], size[1], seed, repeats, 5, bar)
    for name in ("forward", "backward"):
        times = row[f"{name}_ms"]
        print(f"{name}: median {times['p50']:.1f} ms, p95 {times['p95']:.1f} ms")
    print(f"pairs: {row['pairs']:,}")
    _write_json(json_file, {**row, "machine": machine()})


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
    _select(backend)
    from hybrid.bench_periphery import bench_periphery as run
    from hybrid.bench_periphery import display_camera
    from hybrid.cache import forest_for
    from hybrid.device import device_arrays
    from hybrid.fovvideovdp import INSTALL
    from hybrid.timing import machine

    loaded = _scene(scene)
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
    _write_json(json_file, [{**row, "scene": loaded.name, "machine": machine()} for row in rows])


@bench_app.command("forest")
def bench_forest(
    nodes: Annotated[int, typer.Option(help="Gaussians of the finest layer.", min=1)] = 1_000_000,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Grow a forest over random Gaussians, load it again, and see what memory rendering takes."""
    _select(backend)
    from hybrid.bench_forest import bench_forest as run
    from hybrid.device import device_arrays
    from hybrid.timing import machine

    row = run(nodes, seed, device_arrays().backend)
    _write_json(json_file, {**row, "machine": machine()})
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
    _select(backend)
    from hybrid.bench_gaze import bench_gaze as run
    from hybrid.bench_periphery import display_camera
    from hybrid.cache import forest_for
    from hybrid.device import device_arrays
    from hybrid.timing import machine

    loaded = _scene(scene)
    found = forest_for(loaded, forest)
    view = display_camera(loaded.camera, shown)
    with progress_bar("bench (frames)") as bar:
        rows = run(device_arrays(), found, view, shown, fov_b, step, span, bar)
    print("change per step, in 1/255   99.9th percentile   largest")
    for row in rows:
        print(f"{row['law']:<27} {row['change_p99_9']:>17.2f} {row['change_max']:>9.2f}")
    _write_json(json_file, [{**row, "scene": loaded.name, "machine": machine()} for row in rows])


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
    _select(backend)
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
    _write_json(json_file, rows)


def _select(backend: str) -> None:
    from pathtrace.backend import select_backend

    select_backend(backend)


def _scene(source: str, max_depth: int | None = None) -> Scene:
    from pathtrace.scene import load_scene

    return load_scene(source, max_depth)


def _view(scene: Scene, file: Path | None, size: tuple[int, int] | None) -> Camera:
    from compose.view import camera_from_json

    camera = scene.camera
    if file is not None:
        try:
            camera = camera_from_json(json.loads(file.read_text()))
        except OSError as error:
            raise UserError(f"--camera {file}: cannot be read ({error.strerror})") from error
        except (ValueError, KeyError, TypeError) as error:
            raise UserError(
                f"--camera {file}: must be JSON with w, h, fl_x, fl_y, cx, cy, transform_matrix ({error!r})"
            ) from error
    if size is None:
        return camera
    if min(size) <= 0:
        raise UserError(f"--size {size[0]} {size[1]}: must be positive")
    return camera.resized(*size)


def _checked(kind: Any, **values: Any) -> Any:
    """Settings from options; what they refuse is the user's mistake."""
    try:
        return kind(**values)
    except ValueError as error:
        raise UserError(str(error)) from error


def _write_json(path: Path | None, content: Any) -> None:
    if path is None:
        return
    text = json.dumps(content, indent=1) + "\n"
    write_whole(path, lambda part: part.write_text(text))


def main() -> None:
    """Entry point: a mistake of the user is one line and exit code 2."""
    try:
        app()
    except UserError as error:
        print(f"hybrid: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
