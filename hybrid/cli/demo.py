"""`hybrid demo`: the window, of Qt or in a browser."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from compose.base.errors import UserError
from compose.eye.gaze import MOST_SECONDS, load_gaze_trace, simulated
from hybrid.cli import options as o
from hybrid.cli.serve import TokenFile, read_token
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings

if TYPE_CHECKING:
    from hybrid.window.messages import Server

# Duration of a simulated gaze trace in seconds.
_SIMULATED = 60.0


def demo(
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="[SCENE]", help="Name of a bundled scene, or a Mitsuba XML file; none with --server."
        ),
    ] = None,
    forest: o.ForestFile = None,
    size: o.FixedSize = (640, 480),
    fov_a: o.FovA = INTERACTIVE.fov_a,
    fov_b: o.FovB = INTERACTIVE.fov_b,
    spp: o.Spp = INTERACTIVE.spp,
    paths: o.Paths = INTERACTIVE.paths.value,
    level: o.Level = None,
    gaussians: o.MostGaussians = None,
    level_jod: o.LevelJod = None,
    acuity_model: o.AcuityModelName = INTERACTIVE.acuity_model,
    integrator: o.IntegratorName = None,
    target: Annotated[
        float | None,
        typer.Option(
            help="Target frame rate in frames per second: adapts radius, samples, layers, rate and scale.",
            min=1,
            max=1000,
            callback=o.finite,
        ),
    ] = None,
    gaze_trace: Annotated[
        Path | None,
        o.viewer(metavar="FILE", help="CSV file with a recorded gaze to replay instead of the mouse."),
    ] = None,
    simulate: Annotated[bool, o.viewer("--simulate", help="Let a simulated viewer look around.")] = False,
    play: Annotated[bool, o.viewer("--play", help="Play a moving scene from the start.")] = False,
    learning: Annotated[
        bool,
        o.viewer(
            "--learning/--no-learning", help="Learn what was not prepared, and what changes, meanwhile."
        ),
    ] = True,
    latency: Annotated[
        float, o.viewer(help="Gaze latency in milliseconds.", min=0, max=60_000, callback=o.finite)
    ] = 0.0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for screenshots and gaze traces.")] = Path(
        "."
    ),
    bench: Annotated[
        float | None,
        o.measurement(
            metavar="SECONDS",
            help="Move the mouse automatically for this long, print timings, and close.",
            min=1,
            max=MOST_SECONDS,
            callback=o.finite,
        ),
    ] = None,
    load: Annotated[
        float,
        o.measurement(
            metavar="SECONDS",
            help="In the middle of --bench, keep one core busy for this long with another process.",
            min=0,
            callback=o.finite,
        ),
    ] = 0.0,
    browser: Annotated[
        bool,
        typer.Option(
            "--browser", help="Serve the window to a browser on this machine instead of opening it."
        ),
    ] = False,
    port: Annotated[
        int | None,
        typer.Option(
            help="Port for the browser, also without --browser. Default: a free one.", min=1, max=65535
        ),
    ] = None,
    display: o.DisplayName = "desktop",
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    server: Annotated[
        str | None,
        o.network(metavar="URL", help="Draw what a server (`hybrid serve`) decides: wss://HOST:PORT."),
    ] = None,
    token_file: TokenFile = None,
    ca: Annotated[
        Path | None,
        o.network("--ca", metavar="PEM", help="Certificates that the server's may be signed with."),
    ] = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Look around in a window: the mouse is the gaze, and what is path-traced follows it."""
    o.require_size(size, least=64)
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
        paths=paths,
        level=level,
        gaussians=gaussians,
        level_jod=level_jod,
    )
    remote = _server(scene, server, token_file, ca)
    if target is not None and remote is not None:
        raise UserError("--target: measures paths, which --server has none of")
    if target is not None and settings.is_continuous:
        raise UserError("--target: chooses layers; leave out --level, --gaussians and --level-jod")
    o.check_writable(out / "picture.png")
    if gaze_trace is not None and simulate:
        raise UserError("--gaze-trace, --simulate: the gaze can only come from one of them")
    # Without any, the mouse is the gaze.
    trace = None
    if simulate:
        trace = simulated(settings.display, *size, _SIMULATED, seed)
    elif gaze_trace is not None:
        trace = load_gaze_trace(gaze_trace).on(settings.display, *size)
    from hybrid.window.qt_check import window_problem

    why = None if browser or port is not None else window_problem()
    if why is not None:
        print(f"in a browser, since {why}", flush=True)
    from hybrid.window.learning import ShownScene
    from hybrid.window.viewer import Viewer, WindowOptions, viewer_of

    options = WindowOptions(size, latency / 1000, out, target, bench, load, play)
    if remote is not None:
        from hybrid.window.remote.source import prepared_remote
        from hybrid.window.render_thread import RenderThread

        viewer = Viewer(RenderThread(partial(prepared_remote, remote, backend)), settings, trace, options)
    else:
        shown = ShownScene(str(scene), thin_glass, sensor, backend)
        viewer = viewer_of(shown, forest, settings, trace, options, learning)
    if browser or port is not None or why is not None:
        from hybrid.window.browser import serve_window

        serve_window(viewer, lambda address: print(f"open {address}", flush=True), port or 0)
    else:
        from hybrid.window.main_window import run_window

        run_window(viewer)
    found, summary = viewer.measured()
    if bench is not None:
        print(summary)
    return found


def _server(
    scene: str | None, server: str | None, token_file: Path | None, authority: Path | None
) -> Server | None:
    if (scene is None) == (server is None):
        raise UserError("SCENE, --server: name one of them")
    if server is None:
        if token_file is not None or authority is not None:
            raise UserError("--token-file, --ca: are for --server")
        return None
    if token_file is None:
        raise UserError("--server: asks for a token; give --token-file")
    from hybrid.window.messages import Server

    return Server(server, read_token(token_file), authority)
