"""Options that commands share, in groups, and what all commands do first and last.

Mitsuba, torch and everything that requires them are imported inside functions, so that `--help` answers at
once, and a missing package or LLVM is one line instead of a traceback.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from compose.base.errors import MOST_SEED, UserError
from compose.base.files import json_text, write_whole
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import MOST_SPP
from splat.model.choices import Precision

if TYPE_CHECKING:
    from compose.camera.camera import Camera
    from hybrid.render.frame_settings import FrameSettings
    from pathtrace.scene.scene import Scene

# The ends of options that nothing else bounds. Some parts of references have eight times as many samples.
MOST_REFERENCE_SPP = MOST_SPP // 8
MOST_FRAMES = 1_000_000
MOST_DEPTH = 1_000_000
MOST_GAUSSIANS = 100_000_000
_MOST_SIDE = 16_384
# Groups of options in the help.
FRAME, VIEWER, INPUT, MEASUREMENT, RUN = "Frame", "Viewer", "Input", "Measurement", "Run"


def _writable(path: Path | None) -> Path | None:
    """The file of `--json`; refused before long work if it cannot be written."""
    if path is not None:
        from hybrid.render.image_files import check_writable

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


SceneName = Annotated[
    str, typer.Argument(metavar="SCENE", help="Name of a bundled scene, or a Mitsuba XML file.")
]
FramesFolder = Annotated[Path, typer.Argument(metavar="FRAMES", help="Folder of a frame set.")]
ForestArgument = Annotated[Path, typer.Argument(metavar="FOREST", help="Forest file.")]

Gaze = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--gaze", metavar="X Y", help="Fractions of the frame; its centre if left out.", rich_help_panel=FRAME
    ),
]
FovA = Annotated[
    float,
    typer.Option(
        "--fov-a", help="Radius of the path-traced disc, percent of the height.", rich_help_panel=FRAME
    ),
]
FovB = Annotated[
    float,
    typer.Option(
        "--fov-b",
        help="Radius inside of which no splats are visible, percent of the height.",
        rich_help_panel=FRAME,
    ),
]
Spp = Annotated[
    int,
    typer.Option("--spp", help="Samples per pixel in the disc.", min=1, max=MOST_SPP, rich_help_panel=FRAME),
]
Fovea = Annotated[
    str | None,
    typer.Option(
        help="raw: unbiased samples; denoised: by OIDN; fused: with the splats under the disc. Default: raw "
        "where noise is planned to be negligible, else fused.",
        rich_help_panel=FRAME,
    ),
]
IntegratorName = Annotated[
    str | None,
    typer.Option(
        "--integrator",
        help="path: unbiased; cached: paths end in known irradiance, with less noise but biased. "
        "Default: path for a raw fovea, else cached.",
        rich_help_panel=FRAME,
    ),
]
Size = Annotated[
    tuple[int, int] | None,
    typer.Option("--size", metavar="W H", help="Frame size; the scene's if left out.", rich_help_panel=FRAME),
]
FixedSize = Annotated[
    tuple[int, int], typer.Option("--size", metavar="W H", help="Frame size.", rich_help_panel=FRAME)
]
Layers = Annotated[
    tuple[int, int] | None,
    typer.Option(
        metavar="LOW HIGH",
        help="Coarsest and finest layer to draw; 1 is the coarsest.",
        rich_help_panel=FRAME,
    ),
]
AcuityModelName = Annotated[
    str,
    typer.Option(
        "--acuity-model",
        help="What the eye resolves: fovvideovdp, geisler-perry, stelacsf, fov-gs, or none for all.",
        rich_help_panel=VIEWER,
    ),
]
DisplayName = Annotated[
    str,
    typer.Option(
        "--display",
        metavar="NAME",
        help="desktop, hmd, or a JSON file with width, height and fov.",
        rich_help_panel=VIEWER,
    ),
]
ForestFile = Annotated[
    Path | None,
    typer.Option(
        "--forest", metavar="FOREST", help="The newest one of the scene if left out.", rich_help_panel=INPUT
    ),
]
MaxDepth = Annotated[
    int | None,
    typer.Option(
        "--max-depth",
        help="Path depth; as planned for the scene if left out.",
        min=1,
        max=MOST_DEPTH,
        rich_help_panel=INPUT,
    ),
]
ThinGlass = Annotated[
    bool,
    typer.Option(
        "--thin-glass",
        help="Panes of glass let shadow rays pass: far less noise where light comes through them.",
        rich_help_panel=INPUT,
    ),
]
RegionName = Annotated[
    str | None,
    typer.Option(
        "--region",
        metavar="near|reachable|FILE",
        help="Where viewers may be: around the scene's camera, in all free space, or along a path. As "
        "planned, else near, if left out.",
    ),
]
Repeats = Annotated[
    int, typer.Option(help="Measured frames per row.", min=3, max=MOST_FRAMES, rich_help_panel=MEASUREMENT)
]
WarmUp = Annotated[
    int, typer.Option(help="Frames before them.", min=1, max=MOST_FRAMES, rich_help_panel=MEASUREMENT)
]
ReferenceSpp = Annotated[
    int,
    typer.Option(
        help="Samples per pixel of the references.",
        min=4,
        max=MOST_REFERENCE_SPP,
        rich_help_panel=MEASUREMENT,
    ),
]
Backend = Annotated[str, typer.Option(help="auto, cuda or llvm.", rich_help_panel=RUN)]
Seed = Annotated[
    int,
    typer.Option(
        help="Same seed, same result on the same machine.", min=0, max=MOST_SEED, rich_help_panel=RUN
    ),
]
NumberPrecision = Annotated[
    Precision,
    typer.Option(
        help="Of the numbers in a forest file: rounded to what can be seen, a fifth of the size, or exact."
    ),
]
Json = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="Write what was measured.", callback=_writable, rich_help_panel=RUN
    ),
]


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

    Args:
        settings: those whose options have the same name.
        options: names of other options, by setting.
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


def loaded_scene(source: str, max_depth: int | None = None, thin_glass: bool = False) -> Scene:
    """A scene by a bundled name or from a Mitsuba XML file, as its stored plan has it if there is one."""
    from hybrid.preparation.scene_plan import scene_as_stored

    return scene_as_stored(source, max_depth, thin_glass)


def planned_scene(source: str, max_depth: int | None = None, thin_glass: bool = False) -> Scene:
    """As `loaded_scene`, with a plan that is made if there is none."""
    from hybrid.preparation.scene_plan import planned_scene as load

    return load(source, max_depth, thin_glass, progress_bar)


def fill_irradiance(scene: Scene, settings: FrameSettings) -> None:
    """Fills the scene's irradiance cache if frames require it and there is none, with a progress bar."""
    from hybrid.render.irradiance import cache_for
    from pathtrace.trace.integrator import Integrator

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


def write_json(path: Path | None, content: Any) -> None:
    """Writes what was measured, if `--json` asks for it; the file appears whole or not at all."""
    if path is not None:
        text = json_text(content)
        write_whole(path, lambda part: part.write_text(text))
