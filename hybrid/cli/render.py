"""`hybrid render`: one frame, or a film along a gaze trace."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from compose.base.errors import UserError
from compose.eye.acuity import DEFAULT_ACUITY_MODEL
from hybrid.cli.options import (
    AcuityModel,
    Backend,
    DisplayName,
    ForestFile,
    FovA,
    FovB,
    Json,
    Layers,
    SceneName,
    Seed,
    Size,
    Spp,
    checked,
    loaded_scene,
    select,
    sized,
    write_json,
)
from hybrid.runtime.progress import progress_bar

if TYPE_CHECKING:
    from compose.camera.camera import Camera
    from pathtrace.scene.scene import Scene

# Frames per second of a film.
_FPS = 30


def render(
    scene: SceneName,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="FILE", help="A .exr or .png file; of a gaze trace, .mp4."),
    ],
    forest: ForestFile = None,
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="JSON with the names of transforms.json.")
    ] = None,
    gaze: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="X Y", help="Fractions of the frame. Default: its centre."),
    ] = None,
    gaze_trace: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="CSV with seconds, x, y: a film of what a viewer saw."),
    ] = None,
    fps: Annotated[
        int | None, typer.Option(help=f"Frames per second of a film. Default: {_FPS}.", min=1, max=240)
    ] = None,
    fov_a: FovA = 20.0,
    fov_b: FovB = 15.0,
    spp: Spp = 4,
    size: Size = None,
    fovea: Annotated[
        str,
        typer.Option(
            help="raw: what Mitsuba gives, unbiased; denoised: OIDN; fused: with the splats under the disc."
        ),
    ] = "fused",
    target_ms: Annotated[
        float | None,
        typer.Option(
            help="Choose fovea, radii and samples: the best that hybrid sweep --over trade has "
            "measured, with this forest, acuity model, display and size, to take no longer.",
            min=0,
        ),
    ] = None,
    target_jod: Annotated[
        float | None, typer.Option(help="The same: the fastest measured to be at least so good.", max=10)
    ] = None,
    acuity_model: AcuityModel = DEFAULT_ACUITY_MODEL,
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
    """Render one hybrid frame, EXR with all layers in linear radiance or PNG in sRGB; or a film."""
    from compose.eye.acuity import acuity_model_named
    from compose.eye.display import display_named
    from compose.eye.gaze import Gaze
    from compose.eye.gaze_trace import load_gaze_trace
    from compose.fovea.mode import mode_named
    from compose.fovea.region import Foveation
    from hybrid.output.images import check_writable, write_bytes, write_layers, write_png

    kinds = (".exr", ".png") if gaze_trace is None else (".mp4",)
    if output.suffix.lower() not in kinds:
        of_what = "" if gaze_trace is None else " of a gaze trace"
        raise UserError(f"--output {output}{of_what}: must end in {' or '.join(kinds)}")
    if gaze_trace is not None and detail is not None:
        raise UserError("--detail, --gaze-trace: the picture of levels is one of a single frame")
    if gaze_trace is not None and gaze is not None:
        raise UserError("--gaze, --gaze-trace: the gaze can only come from one of them")
    if gaze_trace is None and fps is not None:
        raise UserError(f"--fps {fps}: only a film has a frame rate; it needs --gaze-trace")
    trace = None if gaze_trace is None else load_gaze_trace(gaze_trace)
    if detail is not None and detail.suffix.lower() != ".png":
        raise UserError(f"--detail {detail}: must end in .png")
    at = Gaze() if gaze is None else checked(Gaze, x=gaze[0], y=gaze[1])
    foveation = Foveation(at, fov_a, fov_b)
    acuity_model_named(acuity_model)
    mode_named(fovea)
    shown = display_named(display)
    has_target = target_ms is not None or target_jod is not None
    for option, value in (("--layers", layers), ("--max-depth", max_depth)):
        if has_target and value is not None:
            raise UserError(f"--target-ms, --target-jod: nothing is measured with {option}; leave it out")
    for file in (output, detail):
        if file is not None:
            check_writable(file)
    select(backend)
    from hybrid.frame.aovs import frame_layers
    from hybrid.frame.periphery import Viewing
    from hybrid.frame.renderer import HybridRenderer
    from hybrid.pictures.levels import detail_picture
    from hybrid.plan.trade import chosen, not_measured, remembered_trade, trade_identity
    from hybrid.store.cache import newest_forest
    from hybrid.training.quick import forest_for
    from hybrid.video.video import check_film, write_film

    loaded = loaded_scene(scene, max_depth)
    view = _view(loaded, camera, size)
    if trace is not None:
        check_film(view)
    pixels = view.width, view.height
    measure = _trade_command(scene, forest, pixels, acuity_model, display, backend)
    if has_target and forest is None and newest_forest(loaded) is None:
        raise not_measured(measure)
    found = forest_for(loaded, forest)
    if has_target:
        of = trade_identity(loaded, found, pixels, acuity_model, shown)
        choice = chosen(remembered_trade(loaded, of, measure), target_ms, target_jod)
        fovea, spp = choice.fovea, choice.spp
        foveation = Foveation(foveation.gaze, choice.fov_a, choice.fov_b)
        print(
            f"--fovea {fovea} --spp {spp} --fov-a {choice.fov_a:g} --fov-b {choice.fov_b:g}: "
            f"measured to take {choice.milliseconds:.0f} ms in the scene's own view"
        )
    viewing = Viewing(shown, acuity_model, layers)
    made = {
        "scene": loaded.name,
        "width": view.width,
        "height": view.height,
        "spp": spp,
        "fov_a": foveation.fov_a,
        "fov_b": foveation.fov_b,
        "fovea": fovea,
        "acuity_model": acuity_model,
        "pixels_per_degree": shown.pixels_per_degree,
    }
    renderer = HybridRenderer(loaded, found, viewing, fovea, remembers=trace is not None)
    if trace is not None:
        rate = fps or _FPS
        identity = made | {
            "scene": loaded.hash,
            "forest": found.digest(),
            "camera": view.key.hex(),
            "max-depth": loaded.max_depth,
            "layers": layers,
            "gaze-trace": trace.digest(),
            "fps": rate,
            "seed": seed,
        }
        with progress_bar("film (frames)") as bar:
            times = write_film(output, renderer, view, foveation, trace, rate, spp, seed, identity, bar)
        write_json(json_file, made | {"fps": rate, "frames": times})
        print(f"{output}: {len(times)} frames of {view.width} x {view.height}")
        return
    frame = renderer.frame(view, foveation, spp, seed)
    if output.suffix.lower() == ".exr":
        write_layers(output, frame_layers(renderer, view, foveation.gaze, frame))
    else:
        write_png(output, frame.composite)
    if detail is not None:
        write_bytes(detail, detail_picture(frame.composite, frame.detail, frame.region))
    write_json(
        json_file,
        made
        | {
            "nodes_drawn": frame.nodes_drawn,
            "pixels_excluded": frame.fovea.excluded,
            "milliseconds": frame.milliseconds,
        },
    )
    print(f"{output}: {view.width} x {view.height}, {frame.milliseconds['total']:.0f} ms")


def _trade_command(
    scene: str, forest: Path | None, size: tuple[int, int], acuity_model: str, display: str, backend: str
) -> str:
    """What measures the settings that a target chooses from, with the options that it depends on."""
    options = [
        ("--acuity-model", acuity_model, DEFAULT_ACUITY_MODEL),
        ("--display", display, "desktop"),
        ("--backend", backend, "auto"),
    ]
    words = ["hybrid", "sweep", scene, "--over", "trade", "--size", str(size[0]), str(size[1])]
    words += [] if forest is None else ["--forest", str(forest)]
    words += [word for option, value, usual in options if value != usual for word in (option, value)]
    return shlex.join(words)


def _view(scene: Scene, file: Path | None, size: tuple[int, int] | None) -> Camera:
    from compose.camera.serialization import camera_from_json

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
    return sized(camera, size)
