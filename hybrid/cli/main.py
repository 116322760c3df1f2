"""The commands: thin, each checks what the user gave, calls one function and prints what came out.

Mitsuba, torch and everything that needs them are imported inside the commands, so that `--help` answers
at once and a missing package or LLVM is a line, not a traceback.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from compose.base.errors import UserError
from hybrid.cli.bench import bench_app
from hybrid.cli.demo import demo
from hybrid.cli.evaluate import evaluate
from hybrid.cli.options import (
    Backend,
    FovA,
    FovB,
    Json,
    SceneName,
    Seed,
    checked,
    loaded_scene,
    select,
    write_json,
)
from hybrid.cli.render import render
from hybrid.cli.sweep import sweep
from hybrid.runtime.progress import progress_bar

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Path-traced fovea, Gaussian-splat periphery: one scene, two renderers, one frame.",
)
app.add_typer(bench_app, name="bench")
app.command()(render)
app.command()(evaluate)
app.command()(sweep)
app.command()(demo)


@app.command()
def doctor(backend: Backend = "auto", json_file: Json = None) -> None:
    """Say which backend runs, why, and what to install where something is missing."""
    from hybrid.runtime.doctor import examine

    report = examine(backend)
    for line in report.lines():
        print(line)
    write_json(json_file, report.facts)
    if report.problem:
        raise UserError(report.problem)


@app.command()
def scenes(backend: Backend = "auto", json_file: Json = None) -> None:
    """List the bundled scenes and their facts."""
    select(backend)
    from hybrid.store.cache import newest_forest
    from pathtrace.scene.bundled import bundled_scenes
    from pathtrace.scene.scene import load_scene
    from splat.io.forest_file import load_forest

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
    write_json(json_file, rows)


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
    select(backend)
    from compose.eye.gaze import Gaze
    from compose.fovea.region import Foveation
    from hybrid.output.images import check_writable
    from hybrid.quickstart.quickstart import SIZE
    from hybrid.quickstart.quickstart import quickstart as run

    # Bad radii are refused before the long work begins.
    if not len(Foveation(Gaze(), fov_a, fov_b).region(SIZE, SIZE).pixels):
        raise UserError(f"--fov-a {fov_a}: there is no fovea to show, it holds no pixel of {SIZE} x {SIZE}")
    check_writable(out / "result.json")
    result = run(loaded_scene(scene), out, fov_a, fov_b, seed)
    write_json(out / "result.json", result)
    write_json(json_file, result)
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
    select(backend)
    import time

    from pathtrace.dataset.capture import CaptureSettings
    from pathtrace.dataset.capture import capture as run

    settings = checked(
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
        found = run(loaded_scene(scene, max_depth), frames, settings, bar)
    row = {
        "scene": found.scene_name,
        "views": len(found.training),
        "held_out": len(found.held_out),
        "width": size[0],
        "height": size[1],
        "spp": spp,
        "seconds": time.perf_counter() - start,
    }
    write_json(json_file, row)
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
    select(backend)
    from hybrid.output.images import check_writable
    from hybrid.runtime.device import device_arrays
    from hybrid.store.cache import remember_forest
    from hybrid.training.forest import held_out_quality, train_forest
    from pathtrace.dataset.frames import read_frame_set
    from splat.training.trainer import TrainingSettings

    settings = checked(
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
    write_json(json_file, row)
    print(f"{sum(trained.counts):,} nodes in {trained.counts[0]:,} trees in {seconds:.0f} s")
    for layer in measured:
        print(
            f"layer {layer['layer']}: {layer['nodes']:,} nodes"
            + (f", held-out views {layer['psnr']:.2f} dB, SSIM {layer['ssim']:.4f}" if found.held_out else "")
        )


@app.command("export")
def export_command(
    forest: Annotated[Path, typer.Argument(metavar="FOREST")],
    output: Annotated[Path, typer.Argument(metavar="out.ply")],
    layer: Annotated[
        int | None, typer.Option(help="1, the coarsest, to L; default: L.", show_default=False)
    ] = None,
) -> None:
    """Write one layer of a forest as a PLY file that other viewers of 3D Gaussian splatting open."""
    from splat.io.forest_file import load_forest
    from splat.io.ply import export_ply

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
    from splat.io.forest_file import save_forest
    from splat.io.ply import UNBOUND_FOCAL, import_ply
    from splat.model.forest import forest_of, static_layer

    gaussians = import_ply(source)
    save_forest(forest, forest_of([static_layer(gaussians)], UNBOUND_FOCAL, source.stem, ""))
    print(f"{forest}: {len(gaussians):,} Gaussians, degree {gaussians.degree}")


def main() -> None:
    """Entry point: a mistake of the user is one line and exit code 2."""
    try:
        app()
    except UserError as error:
        print(f"hybrid: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
