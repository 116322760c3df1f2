"""Options that several commands share, and what all of them do first and last.

Mitsuba, torch and everything that needs them are imported inside the functions, so that `--help` answers
at once and a missing package or LLVM is a line, not a traceback.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from compose.base.errors import UserError
from compose.base.files import write_whole

if TYPE_CHECKING:
    from compose.camera.camera import Camera
    from pathtrace.scene.scene import Scene


def _writable(path: Path | None) -> Path | None:
    """The file that `--json` names, refused before the long work where it cannot be written."""
    if path is not None:
        from hybrid.output.images import check_writable

        try:
            check_writable(path)
        except UserError as error:
            raise UserError(f"--json {error}") from error
    return path


SceneName = Annotated[
    str, typer.Argument(metavar="SCENE", help="A bundled scene's name or a Mitsuba XML file.")
]
Backend = Annotated[str, typer.Option(help="auto, cuda or llvm.")]
Json = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write what was measured.", callback=_writable),
]
Seed = Annotated[int, typer.Option(help="Same seed, same result on the same machine.", min=0)]
ForestFile = Annotated[
    Path | None, typer.Option("--forest", metavar="FOREST", help="Default: the newest one of the scene.")
]
FovA = Annotated[
    float, typer.Option("--fov-a", help="Radius of the path-traced disc, percent of the height.")
]
FovB = Annotated[float, typer.Option("--fov-b", help="Radius inside of which no splats are drawn, percent.")]
GazeAt = Annotated[tuple[float, float], typer.Option("--gaze", metavar="X Y", help="Fractions of the frame.")]
AcuityModel = Annotated[
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
Size = Annotated[
    tuple[int, int] | None, typer.Option("--size", metavar="W H", help="Frame size. Default: the scene's.")
]
Spp = Annotated[int, typer.Option("--spp", help="Samples per pixel in the disc.", min=1)]


def checked(kind: Any, **values: Any) -> Any:
    """Settings from options; what they refuse is the user's mistake."""
    try:
        return kind(**values)
    except ValueError as error:
        raise UserError(str(error)) from error


def select(backend: str) -> None:
    """Chooses what everything runs on; before the first import of what needs it."""
    from pathtrace.base.backend import select_backend

    select_backend(backend)


def loaded_scene(source: str, max_depth: int | None = None) -> Scene:
    """A scene by a bundled name or from a Mitsuba XML file."""
    from pathtrace.scene.scene import load_scene

    return load_scene(source, max_depth)


def sized(camera: Camera, size: tuple[int, int] | None) -> Camera:
    """The camera at the size that `--size` asks for."""
    if size is None:
        return camera
    if min(size) <= 0:
        raise UserError(f"--size {size[0]} {size[1]}: must be positive")
    return camera.resized(*size)


def write_json(path: Path | None, content: Any) -> None:
    """Writes what was measured where `--json` asks for it; the file appears whole or not at all."""
    if path is None:
        return
    text = json.dumps(content, indent=1) + "\n"
    write_whole(path, lambda part: part.write_text(text))
