"""`hybrid render` of a folder of frames, without a scene: splats alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from compose.base.errors import UserError
from compose.camera.camera import View
from hybrid.cli.options import sized
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import FrameSettings, aovs_of_file

if TYPE_CHECKING:
    from compose.camera.camera import Camera
    from compose.eye.gaze import GazeTrace
    from hybrid.render.frame import Frame
    from hybrid.render.splat_renderer import SplatRenderer
    from pathtrace.dataset.posed_images import PosedFolder
    from splat.model.forest import Forest

# Parameters of `render` that say how a scene is path-traced.
_OF_SCENES = (
    "fov_a",
    "fov_b",
    "spp",
    "fovea",
    "integrator",
    "target_ms",
    "target_jod",
    "max_depth",
    "thin_glass",
)
# Of a video without a gaze trace, which has a duration of its own.
_SECONDS = 4.0


@dataclass(frozen=True)
class FramesRequest:
    """What is to be rendered of a folder of frames.

    Attributes:
        output: file to write.
        forest: its file; None for the newest one of the folder.
        view: number among the held-out frames, or the training ones if none is held out; None for the first,
            and for a video along all.
        camera: instead of that of a view.
        size: of the frame; None for that of the view.
        time: instead of that of the view.
        eyes: distance between two eyes; None for one.
        detail: file of a picture of the levels.
        trace: where the viewer looks, in a video.
        fps: frames per second of a video.
    """

    output: Path
    forest: Path | None
    view: int | None
    camera: Camera | None
    size: tuple[int, int] | None
    time: float | None
    eyes: float | None
    detail: Path | None
    trace: GazeTrace | None
    fps: int


def refuse_tracing(context: typer.Context, folder: Path) -> None:
    """Refuses options that say how a scene is path-traced: frames have none."""
    for name in _OF_SCENES:
        source = context.get_parameter_source(name)
        # By its name: some versions of Typer have a copy of Click, others the real one.
        if source is not None and source.name == "COMMANDLINE":
            raise UserError(
                f"--{name.replace('_', '-')}: requires a scene to path-trace; {folder} holds frames only, "
                "which are rendered as splats alone"
            )


def render_frames(folder: Path, request: FramesRequest, settings: FrameSettings) -> dict[str, Any]:
    """Renders a frame or a video of a folder; returns what was measured."""
    from hybrid.render.splat_renderer import SplatRenderer
    from pathtrace.dataset.posed_folder import read_posed_folder

    found = read_posed_folder(folder)
    renderer = SplatRenderer(_forest_of(found, request.forest))
    settings.layers_of(len(renderer.forest.counts))
    is_video = request.output.suffix.lower() == ".mp4"
    if is_video:
        facts, settings = _render_video(found, renderer, request, settings)
    else:
        view = _view(found, request)
        settings = replace(settings, camera=view.camera, time=view.time)
        facts = _render_frame(renderer, request, settings)
    assert settings.camera is not None
    return {
        "scene": found.scene_name,
        "width": settings.camera.width,
        "height": settings.camera.height,
        "time": settings.time,
        "acuity_model": settings.acuity_model,
        "pixels_per_degree": settings.display.pixels_per_degree,
        **facts,
    }


def _forest_of(folder: PosedFolder, given: Path | None) -> Forest:
    """The given forest, else the newest one that was trained on the folder's frames."""
    from hybrid.base.cache_folder import newest_forest_of
    from hybrid.base.identity import require_scene
    from splat.io.forest_file import load_forest

    path = given or newest_forest_of(folder.scene_name, folder.scene_hash)
    if path is None:
        raise UserError(f"{folder.folder}: no forest was trained on these frames yet; hybrid train makes one")
    forest = load_forest(path)
    require_scene(forest, folder.scene_name, folder.scene_hash, path)
    return forest


def _views(folder: PosedFolder) -> list[View]:
    """Those of the held-out frames, or of the training ones if none is held out."""
    return [View(image.camera, image.time) for image in folder.held_out or folder.training]


def _view(folder: PosedFolder, request: FramesRequest) -> View:
    """The view of a frame that was asked for."""
    views, number = _views(folder), request.view or 0
    if not 0 <= number < len(views):
        raise UserError(f"--view {number}: {folder.folder} has views 0 to {len(views) - 1}")
    view = views[number]
    time = view.time if request.time is None else request.time
    return View(sized(request.camera or view.camera, request.size), time)


def _render_frame(renderer: SplatRenderer, request: FramesRequest, settings: FrameSettings) -> dict[str, Any]:
    """Renders and writes one frame, or one for each eye."""
    from compose.camera.camera import EYES
    from compose.camera.camera import eyes as eyes_of
    from hybrid.render.false_colours import detail_picture
    from hybrid.render.image_files import write_srgb

    # A forest alone knows no depth.
    settings = replace(settings, aovs=("splat",) if aovs_of_file(request.output) else ())
    assert settings.camera is not None
    if request.eyes is None:
        frame = renderer.frame(settings)
        if request.detail is not None:
            write_srgb(request.detail, detail_picture(frame.composite, frame.detail, frame.region))
        return _saved(frame, request.output)
    found: dict[str, Any] = {}
    for name, eye in zip(EYES, eyes_of(settings.camera, request.eyes), strict=True):
        output = request.output.with_stem(f"{request.output.stem}-{name}")
        found[name] = _saved(renderer.frame(replace(settings, camera=eye)), output)
    return found


def _saved(frame: Frame, output: Path) -> dict[str, Any]:
    """Writes a frame; returns what was measured."""
    frame.save(output)
    camera, milliseconds = frame.camera, frame.milliseconds
    print(f"{output}: {camera.width} x {camera.height}, {milliseconds['total']:.0f} ms")
    return {"nodes_drawn": frame.nodes_drawn, "milliseconds": milliseconds}


def _render_video(
    folder: PosedFolder, renderer: SplatRenderer, request: FramesRequest, settings: FrameSettings
) -> tuple[dict[str, Any], FrameSettings]:
    """Renders and writes a video along the views, in the order of their times."""
    from hybrid.render.image_files import check_video
    from hybrid.render.video import ViewPath, render_splat_video

    views = sorted(_views(folder), key=lambda view: view.time)
    camera = views[0].camera
    # Videos have even sides.
    size = request.size or (camera.width - camera.width % 2, camera.height - camera.height % 2)
    first = View(sized(camera, size), views[0].time)
    check_video(*size)
    path = ViewPath([first, *views[1:]])
    seconds = _SECONDS if request.trace is None else request.trace.duration
    with progress_bar("video (frames)") as bar:
        times = render_splat_video(
            request.output, renderer, settings, path, seconds, request.fps, bar, request.trace
        )
    print(f"{request.output}: {len(times)} frames of {size[0]} x {size[1]}")
    return {"fps": request.fps, "frames": times}, replace(settings, camera=first.camera, time=first.time)
