"""`hybrid demo`: the window."""

from __future__ import annotations

import signal
import sys
from functools import partial
from pathlib import Path
from typing import Annotated

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
    SceneName,
    Seed,
    Spp,
    write_json,
)

# Of a trace that is made up, in seconds.
_SIMULATED = 60.0


def demo(
    scene: SceneName,
    forest: ForestFile = None,
    size: Annotated[tuple[int, int], typer.Option(metavar="W H", help="Frame size in the window.")] = (
        640,
        480,
    ),
    fov_a: FovA = 15.0,
    fov_b: FovB = 11.25,
    spp: Spp = 1,
    acuity_model: AcuityModel = DEFAULT_ACUITY_MODEL,
    target: Annotated[
        float | None,
        typer.Option(
            help="Frames per second to keep: radius, samples, layers, rate and scale follow.", min=1
        ),
    ] = None,
    gaze_trace: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="CSV with seconds, x, y: the gaze goes there, not with the mouse."),
    ] = None,
    simulate: Annotated[bool, typer.Option("--simulate", help="A made-up viewer looks around.")] = False,
    latency: Annotated[float, typer.Option(help="Milliseconds by which the gaze is late.", min=0)] = 0.0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where pictures and gaze traces go.")] = Path("."),
    bench: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Move the mouse for so long, print figures, and close.", min=1),
    ] = None,
    load: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="In the middle of --bench, another process keeps one core busy for so long.",
            min=0,
        ),
    ] = 0.0,
    display: DisplayName = "desktop",
    seed: Seed = 0,
    backend: Backend = "auto",
    json_file: Json = None,
) -> None:
    """Look around in a window: the mouse is the gaze, and the path-traced disc follows it."""
    from compose.eye.acuity import acuity_model_named
    from compose.eye.display import display_named
    from compose.eye.gaze import Gaze
    from compose.eye.gaze_trace import load_gaze_trace
    from compose.eye.saccades import simulated
    from compose.fovea.region import Foveation
    from hybrid.output.images import check_writable

    if min(size) < 64:
        raise UserError(f"--size {size[0]} {size[1]}: must be at least 64 each")
    if gaze_trace is not None and simulate:
        raise UserError("--gaze-trace, --simulate: the gaze can only come from one of them")
    if load and (bench is None or load >= bench):
        raise UserError(f"--load {load}: must be shorter than --bench")
    Foveation(Gaze(), fov_a, fov_b)
    acuity_model_named(acuity_model)
    shown_on = display_named(display)
    check_writable(out / "picture.png")
    trace = None if gaze_trace is None else load_gaze_trace(gaze_trace)
    if simulate:
        trace = simulated(shown_on, *size, _SIMULATED, seed)
    from hybrid.demo.qt import require_window

    require_window()
    from PySide6.QtWidgets import QApplication

    from hybrid.demo.bench import WindowBench, figures, steadiness, summary
    from hybrid.demo.thread import RenderThread
    from hybrid.demo.window import Window
    from hybrid.interactive.gaze_input import GazeInput
    from hybrid.interactive.prepare import prepared
    from hybrid.interactive.request import Settings

    application = QApplication(sys.argv[:1])
    settings = Settings(fov_a, fov_b, spp, acuity_model, target_fps=target)
    thread = RenderThread(partial(prepared, scene, forest, shown_on, backend, bench is None))
    window = Window(thread, settings, size, GazeInput(latency / 1000, trace), out, bench is not None)
    measured = None if bench is None else WindowBench(window, bench, trace is None, load)
    window.show()
    # Qt does not look at Ctrl-C by itself.
    signal.signal(signal.SIGINT, lambda number, frame: window.close())
    application.exec()
    if window.error is not None:
        raise window.error
    found = figures(window, 0.0 if measured is None else measured.start)
    if target is not None:
        found["target"] = steadiness(found["frames"], target, None if measured is None else measured.loaded)
    write_json(json_file, found)
    if measured is not None:
        print(summary(found))
