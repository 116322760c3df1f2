"""`hybrid demo`: the window."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from compose.base.errors import UserError
from compose.eye.gaze import MOST_SECONDS
from hybrid.cli.options import (
    MEASUREMENT,
    VIEWER,
    AcuityModelName,
    Backend,
    DisplayName,
    FixedSize,
    ForestFile,
    FovA,
    FovB,
    IntegratorName,
    Json,
    SceneName,
    Seed,
    Spp,
    ThinGlass,
    finite,
    require_size,
    write_json,
)
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings

if TYPE_CHECKING:
    from compose.eye.gaze import GazeTrace

# Duration of a simulated gaze trace in seconds.
_SIMULATED = 60.0


def demo(
    scene: SceneName,
    forest: ForestFile = None,
    size: FixedSize = (640, 480),
    fov_a: FovA = INTERACTIVE.fov_a,
    fov_b: FovB = INTERACTIVE.fov_b,
    spp: Spp = INTERACTIVE.spp,
    acuity_model: AcuityModelName = INTERACTIVE.acuity_model,
    integrator: IntegratorName = None,
    target: Annotated[
        float | None,
        typer.Option(
            help="Frames per second to keep; chooses radius, samples, layers, rate and scale.",
            min=1,
            max=1000,
            callback=finite,
        ),
    ] = None,
    gaze_trace: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="CSV with seconds, x, y to replay instead of the mouse.",
            rich_help_panel=VIEWER,
        ),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="A simulated viewer looks around.", rich_help_panel=VIEWER)
    ] = False,
    play: Annotated[
        bool, typer.Option("--play", help="A scene that moves plays from the start.", rich_help_panel=VIEWER)
    ] = False,
    latency: Annotated[
        float,
        typer.Option(
            help="Delay of the gaze in milliseconds.",
            min=0,
            max=60_000,
            callback=finite,
            rich_help_panel=VIEWER,
        ),
    ] = 0.0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for screenshots and gaze traces.")] = Path(
        "."
    ),
    bench: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Move the mouse for that long, print figures, and close.",
            min=1,
            max=MOST_SECONDS,
            callback=finite,
            rich_help_panel=MEASUREMENT,
        ),
    ] = None,
    load: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="In the middle of --bench, another process keeps one core busy for that long.",
            min=0,
            callback=finite,
            rich_help_panel=MEASUREMENT,
        ),
    ] = 0.0,
    display: DisplayName = "desktop",
    thin_glass: ThinGlass = False,
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Look around in a window: the mouse is the gaze, and the path-traced disc follows it."""
    from hybrid.render.image_files import check_writable

    require_size(size, least=64)
    if load and (bench is None or load >= bench):
        raise UserError(f"--load {load}: must be shorter than --bench")
    settings = FrameSettings(
        INTERACTIVE.gaze,
        fov_a,
        fov_b,
        spp,
        acuity_model=acuity_model,
        display=display,
        integrator=integrator,
    )
    check_writable(out / "picture.png")
    trace = _trace(gaze_trace, simulate, settings, size, seed)
    from hybrid.window.qt_check import require_window

    require_window()
    from hybrid.window.application import WindowOptions, run_window

    options = WindowOptions(size, latency / 1000, out, target, bench, load, play)
    found, summary = run_window(scene, forest, backend, settings, trace, options, thin_glass)
    write_json(json_file, found)
    if bench is not None:
        print(summary)


def _trace(
    file: Path | None, simulate: bool, settings: FrameSettings, size: tuple[int, int], seed: int
) -> GazeTrace | None:
    """The gaze trace to replay; None for the mouse."""
    from compose.eye.gaze import load_gaze_trace, simulated

    if file is not None and simulate:
        raise UserError("--gaze-trace, --simulate: the gaze can only come from one of them")
    if simulate:
        return simulated(settings.display, *size, _SIMULATED, seed)
    return None if file is None else load_gaze_trace(file)
