"""`hybrid render`: one frame, or a video along a gaze trace, with settings as given or as measured."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from compose.base.errors import UserError, one_line
from compose.base.files import read_json
from compose.camera.camera import Camera
from compose.camera.coordinate_systems import camera_from_json
from compose.eye.gaze import MOST_SECONDS, AngularTrace, GazeTrace, load_gaze_trace
from compose.fovea.foveation import FoveaMode, Placement
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from hybrid.cli.render_frames import (
    refuse_tracing,
    render_splats,
    render_views,
    splat_facts,
    splat_renderer,
    view_of,
    write_frames,
)
from hybrid.render.frame_settings import DEFAULTS, FrameSettings, aovs_of_file

if TYPE_CHECKING:
    from hybrid.render.frame import Frame
    from pathtrace.scene.scene import Scene
    from splat.model.forest import Forest

# Share of a view that the forest does not know, beyond which the user is told.
_MUCH_FILLED = 0.25
_FPS = 30


def render(
    context: typer.Context,
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE",
            help="Name of a bundled scene, a Mitsuba XML file, or a folder of third-party posed images "
            "(splats alone).",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help=".exr or .png; .mp4 with a gaze trace, or along the views of a folder of images.",
        ),
    ],
    forest: o.ForestFile = None,
    camera: Annotated[
        Path | None, o.frame(metavar="FILE", help="JSON file with the keys of transforms.json.")
    ] = None,
    view: Annotated[
        int | None,
        o.frame(help="Held-out view of a folder of images, counted from 0: its camera and time.", min=0),
    ] = None,
    gaze: o.Gaze = None,
    gaze_trace: Annotated[
        Path | None, o.viewer(metavar="FILE", help="CSV file with a recorded gaze: renders a video.")
    ] = None,
    fps: Annotated[
        int | None, typer.Option(help=f"Frames per second of a video. Default: {_FPS}.", min=1, max=240)
    ] = None,
    fov_a: o.FovA = DEFAULTS.fov_a,
    fov_b: o.FovB = DEFAULTS.fov_b,
    spp: o.Spp = DEFAULTS.spp,
    size: o.Size = None,
    fovea: o.Fovea = None,
    paths: o.Paths = DEFAULTS.paths.value,
    integrator: o.IntegratorName = None,
    target_ms: Annotated[
        float | None,
        o.frame(
            help="Time budget of the frame in milliseconds: chooses fovea, radii and samples, the best that "
            "were measured with this forest, acuity model, display and size (hybrid sweep --over trade).",
            min=0,
            callback=o.finite,
        ),
    ] = None,
    target_jod: Annotated[
        float | None,
        o.frame(
            help="Likewise the least quality in JOD: chooses the fastest settings that reach it.",
            max=10,
            callback=o.finite,
        ),
    ] = None,
    time: Annotated[
        float | None,
        o.frame(
            help="Time of a moving scene, from 0 to 1. Default: 0, or that of the view.",
            min=0,
            max=1,
            callback=o.finite,
        ),
    ] = None,
    eyes: Annotated[
        float | None,
        o.viewer(
            metavar="DISTANCE",
            help="Render both eyes, this far apart in scene units: writes NAME-left and NAME-right.",
            min=0,
            callback=o.finite,
        ),
    ] = None,
    acuity_model: o.AcuityModelName = DEFAULTS.acuity_model,
    layers: o.Layers = None,
    level: o.Level = None,
    gaussians: o.MostGaussians = None,
    level_jod: o.LevelJod = None,
    display: o.DisplayName = "desktop",
    detail: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write a PNG of level, rate and eccentricity.")
    ] = None,
    max_depth: o.MaxDepth = None,
    thin_glass: o.ThinGlass = False,
    sensor: o.Sensor = None,
    seed: o.Seed = 0,
    backend: o.Backend = "auto",
) -> o.Measured:
    """Render one hybrid frame, as EXR with all AOVs or as PNG; or a video along a gaze trace.

    A folder of third-party posed images (D-NeRF, nerfstudio, COLMAP, Nerfies, HyperNeRF, NeRF-DS) has no
    scene: its frames are splats alone.
    """
    from pathtrace.dataset.posed_layouts import is_posed_folder

    is_folder = is_posed_folder(Path(scene))
    is_path = is_folder and output.suffix.lower() == ".mp4"
    if is_folder:
        refuse_tracing(context, Path(scene), is_path)
    elif view is not None:
        raise UserError(
            f"--view {view}: only for a folder of images; a scene has its own camera, or takes --camera"
        )
    settings = FrameSettings(
        gaze or DEFAULTS.gaze,
        fov_a,
        fov_b,
        spp,
        DEFAULTS.fovea if fovea is None else fovea,
        acuity_model,
        layers,
        display=display,
        integrator=integrator,
        time=time or DEFAULTS.time,
        paths=paths,
        level=level,
        gaussians=gaussians,
        level_jod=level_jod,
    )
    _check_layers(settings)
    # Before a forest is prepared for nothing.
    _require_cells(settings)
    _check_outputs(output, detail, eyes, gaze_trace is not None or is_path)
    trace = _loaded_trace(gaze_trace, gaze, fps, is_path)
    if target_ms is not None or target_jod is not None:
        _check_measured(settings, max_depth)
    o.select(backend)
    if is_folder:
        from pathtrace.dataset.posed_layouts import read_posed_folder

        given = None if camera is None else _read_camera(camera)
        images = read_posed_folder(Path(scene))
        shown = None if is_path else view_of(images, view or 0, given, size, time)
        splats = splat_renderer(images, forest)
        settings.layers_of(len(splats.forest.counts))
        if shown is None:
            facts = render_views(output, images, splats, settings, size, trace, fps or _FPS)
        else:
            settings = replace(settings, camera=shown.camera, time=shown.time)
            facts = render_splats(output, detail, eyes, splats, settings)
        return {"scene": images.scene_name, **facts}
    from hybrid.preparation.preparation import with_forest

    loaded = o.loaded_scene(scene, max_depth, thin_glass, sensor)
    if time and loaded.moving is None:
        raise UserError(f"--time: nothing moves in {scene}; it has no motion file")
    own = _view(loaded, camera, size, is_video=trace is not None)
    pixels = own.width, own.height
    command = measuring_command(scene, forest, pixels, settings, display, backend)
    target = TradeTarget(target_ms, target_jod, command)
    target.require_forest(loaded, forest)
    loaded, found = with_forest(loaded, forest, progress_bar)
    settings = _with_fovea(settings, loaded, fovea)
    settings = target.applied(loaded, found, replace(settings, camera=own))
    # Refused before anything is filled.
    settings.layers_of(len(found.counts))
    o.fill_irradiance(loaded, settings)
    if trace is None:
        return _render_frames(output, detail, eyes, loaded, found, settings, seed)
    on_frame = trace.on(settings.display, *pixels)
    return _render_video(output, loaded, found, settings, on_frame, fps or _FPS, seed)


def _check_measured(settings: FrameSettings, max_depth: int | None) -> None:
    """Refuses a target with settings with which nothing is measured that could be chosen."""
    given = {
        "--layers": settings.layers is not None,
        "--level": settings.level is not None,
        "--gaussians": settings.gaussians is not None,
        "--level-jod": settings.level_jod is not None,
        "--max-depth": max_depth is not None,
        "--paths where-needed": settings.paths is Placement.WHERE_NEEDED,
    }
    for option, is_given in given.items():
        if is_given:
            raise UserError(f"--target-ms, --target-jod: nothing is measured with {option}; leave it out")


def _with_fovea(settings: FrameSettings, scene: Scene, given: str | None) -> FrameSettings:
    """The settings with the fovea that is planned for a scene unless one is given."""
    from hybrid.preparation.decisions import DENOISING, RAW

    if given is None and scene.plan.get(DENOISING) == RAW:
        settings = replace(settings, fovea=FoveaMode.RAW)
    _require_cells(settings)
    return settings


def _require_cells(settings: FrameSettings) -> None:
    """Refuses paths where they are needed in frames that would be worse for them."""
    if settings.paths is Placement.WHERE_NEEDED and not settings.traces_cells:
        raise UserError(
            "--paths where-needed: the fovea is raw, and its noise is worse than what paths would mend; "
            "choose --fovea fused or denoised"
        )


@dataclass(frozen=True)
class TradeTarget:
    """The milliseconds that a frame may take and the JOD that it must reach; None for any.

    The command measures the settings to choose from.
    """

    milliseconds: float | None
    jod: float | None
    command: str

    @property
    def is_set(self) -> bool:
        """Whether there is a target at all."""
        return self.milliseconds is not None or self.jod is not None

    def require_forest(self, scene: Scene, given: Path | None) -> None:
        """Checks that settings can have been measured: there must be a forest already."""
        from hybrid.base.cache_folder import newest_forest

        if self.is_set and given is None and newest_forest(scene) is None:
            raise self._not_measured()

    def applied(self, scene: Scene, forest: Forest, settings: FrameSettings) -> FrameSettings:
        """The settings that meet the target, the given ones without one; UserError if none meets it."""
        if not self.is_set:
            return settings
        from hybrid.evaluation.measured_settings import MeasuredStore, chosen

        camera, _ = settings.resolved(scene.camera)
        found = MeasuredStore("trade", scene, forest, (camera.width, camera.height), settings).load()
        if found is None:
            raise self._not_measured()
        choice, metric = chosen(*found, self.milliseconds, self.jod), found[0].upper()
        best, range_ = choice.settings, ""
        if choice.spread is not None:
            low, high = choice.spread
            range_ = f"; {metric} {choice.quality:.4g} ({low:.4g} to {high:.4g})"
        print(
            f"--fovea {best.fovea.value} --spp {best.spp} --fov-a {best.fov_a:g} --fov-b {best.fov_b:g}: "
            f"measured to take {choice.milliseconds:.0f} ms in views that nothing was fitted to{range_}"
        )
        return replace(settings, fovea=best.fovea, spp=best.spp, fov_a=best.fov_a, fov_b=best.fov_b)

    def _not_measured(self) -> UserError:
        return UserError(
            f"--target-ms, --target-jod: these settings have not been measured here; run: {self.command}"
        )


def measuring_command(
    scene: str,
    forest: Path | None,
    size: tuple[int, int],
    settings: FrameSettings,
    display: str,
    backend: str,
) -> str:
    """The command that measures what a target chooses from, with the options that matter."""
    options = [
        ("--acuity-model", settings.acuity_model, DEFAULTS.acuity_model),
        ("--display", display, "desktop"),
        ("--backend", backend, "auto"),
    ]
    words = ["hybrid", "sweep", scene, "--over", "trade", "--size", str(size[0]), str(size[1])]
    words += [] if forest is None else ["--forest", str(forest)]
    words += [word for option, value, default in options if value != default for word in (option, value)]
    return shlex.join(words)


def _check_layers(settings: FrameSettings) -> None:
    if settings.layers is None:
        return
    low, high = settings.layers
    if settings.is_continuous:
        raise UserError(
            "--layers: --level, --gaussians and --level-jod draw no layers; leave out one or the other"
        )
    if not 1 <= low <= high:
        raise UserError(f"--layers {low} {high}: must be the coarsest and the finest to draw, counted from 1")


def _check_outputs(output: Path, detail: Path | None, eyes: float | None, is_video: bool) -> None:
    kinds = (".mp4",) if is_video else (".exr", ".png")
    if output.suffix.lower() not in kinds:
        of_what = " of a gaze trace" if is_video else ""
        raise UserError(f"--output {output}{of_what}: must end in {' or '.join(kinds)}")
    if is_video and detail is not None:
        raise UserError("--detail, --gaze-trace: only a single frame has a picture of its levels")
    if detail is not None and detail.suffix.lower() != ".png":
        raise UserError(f"--detail {detail}: must end in .png")
    if eyes is not None and (is_video or detail is not None):
        raise UserError("--eyes: only for a single frame, without --detail")
    for file in (output, detail):
        o.check_writable(file)


def _loaded_trace(
    file: Path | None, gaze: tuple[float, float] | None, fps: int | None, is_path: bool
) -> GazeTrace | AngularTrace | None:
    from hybrid.render.video import MOST_FRAMES

    if file is None:
        if fps is not None and not is_path:
            raise UserError(f"--fps {fps}: only a video has a frame rate; requires --gaze-trace")
        return None
    if gaze is not None:
        raise UserError("--gaze, --gaze-trace: the gaze can only come from one of them")
    return load_gaze_trace(file, min(MOST_SECONDS, MOST_FRAMES / (fps or _FPS)))


def _view(scene: Scene, file: Path | None, size: tuple[int, int] | None, is_video: bool) -> Camera:
    from hybrid.render.image_files import check_video

    camera = o.sized(scene.camera if file is None else scene.place.camera(_read_camera(file)), size)
    if is_video:
        check_video(camera.width, camera.height)
    return camera


def _read_camera(file: Path) -> Camera:
    try:
        return camera_from_json(read_json(file))
    except OSError as error:
        raise UserError(f"--camera {file}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"--camera {file}: must be JSON with w, h, fl_x, fl_y, cx, cy, transform_matrix "
            f"({one_line(repr(error))})"
        ) from error


def _render_frames(
    output: Path,
    detail: Path | None,
    eyes: float | None,
    scene: Scene,
    forest: Forest,
    settings: FrameSettings,
    seed: int,
) -> dict[str, Any]:
    """Renders and writes one frame, or one per eye; returns what was measured. What moves is moved once."""
    from hybrid.render.frame_renderer import Renderer

    renderer = Renderer(scene, forest)
    camera, settings = replace(settings, aovs=aovs_of_file(output)).resolved(scene.camera)

    def facts_of(frame: Frame) -> dict[str, Any]:
        if frame.filled > _MUCH_FILLED:
            print(
                f"the forest was not prepared for {frame.filled:.0%} of this view, which is path-traced at a "
                "lower resolution; hybrid prepare --region reachable prepares for all that can be reached"
            )
        return _facts(scene, frame.settings) | {
            "nodes_drawn": frame.nodes_drawn,
            "pixels_excluded": frame.fovea.excluded,
            "filled": frame.filled,
            "milliseconds": frame.milliseconds,
        }

    return write_frames(
        output,
        detail,
        camera,
        None if eyes is None else eyes / scene.place.unit,
        lambda shown: renderer.frame(replace(settings, camera=shown), seed),
        facts_of,
    )


def _render_video(
    output: Path, scene: Scene, forest: Forest, settings: FrameSettings, trace: GazeTrace, fps: int, seed: int
) -> dict[str, Any]:
    from hybrid.base.identity import measured_identity
    from hybrid.render.frame_renderer import Renderer
    from hybrid.render.video import render_video

    identity = measured_identity(
        scene, forest, settings=settings.as_json(), gaze_trace=trace.digest(), fps=fps, seed=seed
    )
    renderer = Renderer(scene, forest, history=True)
    with progress_bar("video (frames)") as bar:
        times = render_video(output, renderer, settings, trace, fps, seed, identity, bar)
    facts = _facts(scene, settings)
    print(f"{output}: {len(times)} frames of {facts['width']} x {facts['height']}")
    return facts | {"fps": fps, "frames": times}


def _facts(scene: Scene, settings: FrameSettings) -> dict[str, Any]:
    camera, settings = settings.resolved(scene.camera)
    names = ("spp", "fov_a", "fov_b", "level", "gaussians", "level_jod")
    return {
        "scene": scene.name,
        **splat_facts(settings, camera),
        **{name: getattr(settings, name) for name in names},
        "fovea": settings.fovea.value,
        "paths": settings.paths.value,
        "integrator": settings.used_integrator.value,
        "unbiased": settings.is_unbiased,
    }
