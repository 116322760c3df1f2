"""`hybrid demo`: the window, of Qt or in a browser."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from compose.base.errors import UserError, one_line
from compose.eye.display import Display
from compose.eye.gaze import MOST_SECONDS, GazeTrace, load_gaze_trace, simulated
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from hybrid.cli.serve import TokenFile, read_token
from hybrid.render.frame_settings import INTERACTIVE, FrameSettings

if TYPE_CHECKING:
    from hybrid.window.learning import ShownScene
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
            "--learning/--no-learning",
            help="Learn what was not prepared, what changes, and where you stay, meanwhile.",
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
    xr: Annotated[
        bool,
        typer.Option(
            "--xr", help="Show it in a headset by OpenXR, whose eyes have frames of the height of --size."
        ),
    ] = False,
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
    from hybrid.window.learning import ShownScene

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
    trace = _trace(gaze_trace, simulate, settings.display, size, seed)
    if xr:
        _require_none(
            browser=browser,
            port=port,
            server=server,
            gaze_trace=gaze_trace,
            simulate=simulate,
            target=target,
            latency=latency,
            load=load,
        )
        shown = ShownScene(str(scene), thin_glass, sensor, backend)
        return _in_headset(shown, forest, settings, size[1], play, learning, bench)
    from hybrid.window.qt_check import window_problem

    why = None if browser or port is not None else window_problem()
    if why is not None:
        print(f"in a browser, since {why}", flush=True)
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


def _trace(
    file: Path | None, simulate: bool, display: Display, size: tuple[int, int], seed: int
) -> GazeTrace | None:
    """The gaze to replay; None if the mouse is the gaze."""
    if file is not None and simulate:
        raise UserError("--gaze-trace, --simulate: the gaze can only come from one of them")
    if simulate:
        return simulated(display, *size, _SIMULATED, seed)
    return None if file is None else load_gaze_trace(file).on(display, *size)


def _require_none(**options: object) -> None:
    """UserError if one of some options, which say nothing of a headset, is given."""
    for name, value in options.items():
        if value:
            raise UserError(f"--xr: leave out --{name.replace('_', '-')}")


def _in_headset(
    scene: ShownScene,
    forest: Path | None,
    settings: FrameSettings,
    height: int,
    plays: bool,
    learns: bool,
    seconds: float | None,
) -> o.Measured:
    try:
        from hybrid.window.openxr_headset import OpenXRHeadset
    except ImportError as error:
        install = "pip install 'foveated-hybrid-renderer[xr]'"
        raise UserError(f"--xr: requires pyopenxr: {install} ({one_line(error)})") from error
    from hybrid.window.controls import Playback
    from hybrid.window.frame_source import prepared
    from hybrid.window.headset import show_in_headset
    from hybrid.window.meter import figures, summary

    with OpenXRHeadset() as headset, progress_bar("demo") as bar:
        source = prepared(scene, forest, learns, settings, bar, lambda line: print(line, flush=True))
        length = source.ready().seconds
        playback = None if length is None else Playback(length)
        if playback is not None:
            playback.playing = plays
        try:
            meter, shape = show_in_headset(headset, source, settings, height, playback, seconds)
        finally:
            source.close()
    found = figures(meter, shape, 0.0)
    if seconds is not None:
        print(summary(found))
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
