"""Options that commands share, in groups, and what all commands do first and last.

Mitsuba, torch and everything that requires them are imported inside functions, so that `--help` answers at
once, and a missing package or LLVM is one line instead of a traceback.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from compose.base.errors import MOST_SEED, UserError
from compose.base.files import json_text, write_text
from compose.camera.camera import Camera
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import MOST_LEVEL, MOST_SPP, FrameSettings
from pathtrace.trace import Integrator
from splat.model.choices import Precision

if TYPE_CHECKING:
    from hybrid.preparation.decisions import Value
    from pathtrace.scene.scene import Scene

# The ends of options that nothing else bounds. Some parts of references have eight times as many samples.
MOST_REFERENCE_SPP = MOST_SPP // 8
MOST_FRAMES = 1_000_000
MOST_DEPTH = 1_000_000
MOST_GAUSSIANS = 100_000_000
_MOST_SIDE = 16_384


def check_writable(path: Path | None) -> None:
    """Refuses a file, if one is asked for, before long work if it cannot be written."""
    if path is not None:
        from hybrid.render import image_files

        image_files.check_writable(path)


def require_both(part: str | None, shared: Path | None) -> None:
    """Refuses a part without a folder for it, and a folder without a part."""
    if (part is None) != (shared is None):
        raise UserError("--part and --shared: a part needs both")


def _writable(path: Path | None) -> Path | None:
    try:
        check_writable(path)
    except UserError as error:
        raise UserError(f"--json {error}") from error
    return path


def finite(value: float | None) -> float | None:
    """The value of an option whose range would admit NaN or infinity."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a finite number.")
    return value


# Options in the groups of the help.
frame, viewer, inputs, measurement, network, run = (
    partial(typer.Option, rich_help_panel=group)
    for group in ("Frame", "Viewer", "Input", "Measurement", "Network", "Run")
)

SceneName = Annotated[
    str, typer.Argument(metavar="SCENE", help="Name of a bundled scene, or a Mitsuba XML file.")
]
FramesFolder = Annotated[Path, typer.Argument(metavar="FRAMES", help="Folder of a frame set.")]
ForestArgument = Annotated[Path, typer.Argument(metavar="FOREST", help="Forest file.")]

Gaze = Annotated[
    tuple[float, float] | None,
    frame("--gaze", metavar="X Y", help="Fractions of the frame's width and height. Default: its centre."),
]
FovA = Annotated[float, frame("--fov-a", help="Radius of the path-traced disc, percent of the height.")]
FovB = Annotated[
    float, frame("--fov-b", help="Radius inside which no splats are visible, percent of the height.")
]
Spp = Annotated[int, frame("--spp", help="Samples per pixel in the disc.", min=1, max=MOST_SPP)]
Fovea = Annotated[
    str | None,
    frame(
        help="raw: unbiased samples; denoised: by OIDN; fused: with the splats under the disc. Default: raw "
        "where the plan expects negligible noise, else fused."
    ),
]
Paths = Annotated[
    str,
    frame(
        help="disc: around the gaze; where-needed: as many, in cells all over the frame where the forest "
        "expects the most visible errors."
    ),
]
IntegratorName = Annotated[
    str | None,
    frame(
        "--integrator",
        help="path: unbiased; cached: paths end in known irradiance, with less noise but biased. "
        "Default: path for a raw fovea, else cached.",
    ),
]
Size = Annotated[
    tuple[int, int] | None, frame("--size", metavar="W H", help="Frame size. Default: the scene's.")
]
FixedSize = Annotated[tuple[int, int], frame("--size", metavar="W H", help="Frame size.")]
Layers = Annotated[
    tuple[int, int] | None,
    frame(metavar="LOW HIGH", help="Coarsest and finest layer to draw; 1 is the coarsest."),
]
Level = Annotated[
    float | None,
    frame(
        help="Continuous levels of detail in place of layers: standard deviation that Gaussians may have, in "
        "the finest details that the eye resolves. 1 is hardly seen.",
        min=0,
        max=MOST_LEVEL,
        callback=finite,
    ),
]
MostGaussians = Annotated[
    int | None,
    frame(
        "--gaussians",
        help="Continuous levels of detail: draw at most so many Gaussians in the periphery.",
        min=1,
        max=MOST_GAUSSIANS,
    ),
]
LevelJod = Annotated[
    float | None,
    frame(
        help="Continuous levels of detail: as few Gaussians as this quality takes, in JOD against the finest "
        "layer, as hybrid levels has learnt it for the display.",
        min=0,
        max=10,
        callback=finite,
    ),
]
AcuityModelName = Annotated[
    str,
    viewer(
        "--acuity-model",
        help="What the eye resolves: fovvideovdp, geisler-perry, resolution-limit, resolution-limit-95, "
        "stelacsf, fov-gs, or none for full detail.",
    ),
]
DisplayName = Annotated[
    str, viewer("--display", metavar="NAME", help="desktop, hmd, or a JSON file with width, height and fov.")
]
ForestFile = Annotated[
    Path | None, inputs("--forest", metavar="FOREST", help="Forest file. Default: the scene's newest forest.")
]
MaxDepth = Annotated[
    int | None,
    inputs("--max-depth", help="Path depth. Default: as planned for the scene.", min=1, max=MOST_DEPTH),
]
ThinGlass = Annotated[
    bool,
    inputs(
        "--thin-glass",
        help="Panes of glass let shadow rays pass: far less noise where light comes through them.",
    ),
]
Sensor = Annotated[
    str | None,
    inputs("--sensor", metavar="ID", help="Perspective camera of the scene. Default: the first."),
]
Override = Annotated[
    list[str] | None,
    inputs(
        "--set",
        metavar="NAME=VALUE",
        help="Override a decision of the plan, such as degree=0 or 'path depth=12'. May be repeated.",
    ),
]
RegionName = Annotated[
    str | None,
    typer.Option(
        "--region",
        metavar="near|reachable|FILE",
        help="Where viewers may be: around the scene's camera, in all free space, or along a path. "
        "Default: as planned, else near.",
    ),
]
Repeats = Annotated[int, measurement(help="Measured frames per row.", min=3, max=MOST_FRAMES)]
WarmUp = Annotated[int, measurement(help="Warm-up frames, not measured.", min=1, max=MOST_FRAMES)]
ReferenceSpp = Annotated[
    int, measurement(help="Samples per pixel of the references.", min=4, max=MOST_REFERENCE_SPP)
]
Backend = Annotated[str, run(help="auto, cuda or llvm.")]
Seed = Annotated[int, run(help="Same seed, same result on the same machine.", min=0, max=MOST_SEED)]
PartName = Annotated[
    str | None,
    run(
        "--part",
        metavar="I/N",
        help="Do one of N parts, each on a machine of its own; `hybrid merge` joins them. With --ray: all/N.",
    ),
]
RayAddress = Annotated[
    str | None,
    run(
        "--ray",
        metavar="ADDRESS",
        help="Do all parts as tasks of the Ray cluster at an address, and merge them; local starts Ray here.",
    ),
]
SharedFolder = Annotated[
    Path | None, run("--shared", metavar="DIR", help="Folder for the parts of --part, on all machines.")
]
NumberPrecision = Annotated[
    Precision,
    typer.Option(
        help="Numbers in the forest file: compact, rounded below what is visible, at a fifth of the size; or "
        "float32, exact."
    ),
]
Json = Annotated[
    Path | None, run("--json", metavar="FILE", help="Also write the results as JSON.", callback=_writable)
]


# What a command has measured.
Measured: TypeAlias = dict[str, Any] | list[dict[str, Any]]


def with_json(command: Callable[..., Measured | None]) -> Callable[..., object]:
    """A command with --json, which writes what the command returns, unless it has that option itself."""
    own = signature(command, eval_str=True)
    if "json_file" in own.parameters:
        return command

    @wraps(command)
    def run(*, json_file: Path | None, **given: object) -> None:
        write_json(json_file, command(**given))

    last = Parameter("json_file", Parameter.KEYWORD_ONLY, default=None, annotation=Json)
    run.__dict__["__signature__"] = own.replace(parameters=[*own.parameters.values(), last])
    return run


def given(context: typer.Context, name: str) -> bool:
    """Whether an option was given on the command line, not left at its default."""
    found = context.get_parameter_source(name)
    # By its name: some versions of Typer have a copy of Click, others the real one.
    return found is not None and found.name == "COMMANDLINE"


@contextmanager
def user_errors() -> Iterator[None]:
    """Turns a ValueError of settings into a mistake of the user's."""
    try:
        yield
    except ValueError as error:
        raise UserError(str(error)) from error


@contextmanager
def option_names(*settings: str, **options: str) -> Iterator[None]:
    """Names options in place of settings in front of the colon of a UserError.

    Options have the names of their settings, or those that are given by setting.
    """
    try:
        yield
    except UserError as error:
        named, colon, said = str(error).partition(":")
        for setting, option in ({name: name.replace("_", "-") for name in settings} | options).items():
            named = re.sub(rf"\b{setting}\b", f"--{option}", named, count=1)
        raise UserError(f"{named}{colon}{said}") from error


def select(backend: str) -> None:
    """Selects what everything runs on, before the first import that depends on it."""
    from pathtrace.scene.backend import select_backend

    select_backend(backend)


def loaded_scene(
    source: str, max_depth: int | None = None, thin_glass: bool = False, sensor: str | None = None
) -> Scene:
    """A scene by a bundled name or from a Mitsuba XML file, as its stored plan has it if there is one."""
    from hybrid.preparation.scene_plan import as_stored
    from pathtrace.scene.scene import load_scene

    return as_stored(load_scene(source, max_depth, thin_glass, sensor=sensor))


def planned_scene(
    source: str,
    max_depth: int | None,
    thin_glass: bool,
    sensor: str | None,
    override: list[str] | None = None,
) -> Scene:
    """As `loaded_scene`, with a plan that is made if there is none, and of which items are overridden."""
    from hybrid.preparation.scene_plan import as_planned
    from pathtrace.scene.scene import load_scene

    scene = load_scene(source, max_depth, thin_glass, sensor=sensor)
    return as_planned(scene, progress_bar, overridden(override))


def overridden(override: list[str] | None) -> dict[str, Value]:
    """Items of a plan that `--set` asks for, by name."""
    from hybrid.preparation.decisions import parsed

    try:
        return parsed(override or ())
    except UserError as error:
        raise UserError(f"--set {error}") from error


def fill_irradiance(scene: Scene, settings: FrameSettings) -> None:
    """Fills the scene's irradiance cache if frames require it and there is none, with a progress bar."""
    from hybrid.render.irradiance import cache_for

    if settings.used_integrator is Integrator.CACHED:
        cache_for(scene, progress_bar)


def sized(camera: Camera, size: tuple[int, int] | None) -> Camera:
    """The camera at the size that `--size` asks for."""
    if size is None:
        return camera
    require_size(size)
    return camera.resized(*size)


def require_size(size: tuple[int, int], least: int = 1) -> None:
    """Refuses frame sizes below a minimum, and those that no memory holds."""
    if min(size) < least:
        wanted = "positive" if least == 1 else f"at least {least} each"
        raise UserError(f"--size {size[0]} {size[1]}: must be {wanted}")
    if max(size) > _MOST_SIDE:
        raise UserError(f"--size {size[0]} {size[1]}: must be at most {_MOST_SIDE} each")


def write_json(path: Path | None, content: object) -> None:
    """Writes what was measured, if `--json` asks for it; the file appears whole or not at all."""
    if path is not None:
        write_text(path, json_text(content))
