"""What `hybrid render` does with any forest: files of frames; and with folders of frames, splats alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from compose.base.errors import UserError
from compose.camera.camera import EYES, Camera, View, eyes
from compose.eye.gaze import AngularTrace, GazeTrace
from hybrid.cli import options as o
from hybrid.cli.progress import progress_bar
from hybrid.render.frame_settings import FrameSettings, aovs_of_file

if TYPE_CHECKING:
    from hybrid.render.frame import Frame
    from hybrid.render.splat_renderer import SplatRenderer
    from pathtrace.dataset.posed_images import PosedFolder

# Parameters of `render` that say how a scene is path-traced.
_OF_SCENES = (
    *("fov_a", "fov_b", "spp", "fovea", "paths", "integrator", "target_ms"),
    *("target_jod", "max_depth", "thin_glass", "sensor"),
)
# Of a video without a gaze trace, which has a duration of its own.
_SECONDS = 4.0


def write_frames(
    output: Path,
    detail: Path | None,
    camera: Camera,
    distance: float | None,
    frame_of: Callable[[Camera], Frame],
    facts_of: Callable[[Frame], dict[str, Any]],
) -> dict[str, Any]:
    """Renders and writes a frame, and a picture of its levels if `detail` names a file; or one per eye.

    The camera is the view or, if there is a distance in its units, lies between the eyes. Returns what
    `facts_of` says of the frame; of two eyes, by "left" and "right".
    """
    from hybrid.render.false_colours import detail_picture
    from hybrid.render.image_files import write_srgb

    def saved(frame: Frame, file: Path) -> dict[str, Any]:
        frame.save(file)
        print(f"{file}: {frame.camera.width} x {frame.camera.height}, {frame.milliseconds['total']:.0f} ms")
        return facts_of(frame)

    if distance is None:
        frame = frame_of(camera)
        if detail is not None:
            write_srgb(detail, detail_picture(frame.composite, frame.detail, frame.region))
        return saved(frame, output)
    return {
        name: saved(frame_of(eye), output.with_stem(f"{output.stem}-{name}"))
        for name, eye in zip(EYES, eyes(camera, distance), strict=True)
    }


def refuse_tracing(context: typer.Context, folder: Path, is_path: bool) -> None:
    """Refuses options of path tracing; for a video along all views, those of a single view as well."""
    if is_path and any(o.given(context, name) for name in ("view", "camera", "time")):
        raise UserError(f"--view, --camera, --time: a video of {folder} shows all its views at their times")
    for name in _OF_SCENES:
        if o.given(context, name):
            raise UserError(
                f"--{name.replace('_', '-')}: requires a scene to path-trace; {folder} holds frames only, "
                "which are rendered as splats alone"
            )


def splat_renderer(folder: PosedFolder, given: Path | None) -> SplatRenderer:
    """Renders a given forest, else the newest one that was trained on the folder's frames."""
    from hybrid.base.cache_folder import newest_forest_of
    from hybrid.base.identity import require_scene
    from hybrid.render.splat_renderer import SplatRenderer
    from splat.io.forest_file import load_forest

    path = given or newest_forest_of(folder.scene_name, folder.scene_hash)
    if path is None:
        raise UserError(f"{folder.folder}: no forest was trained on these frames yet; hybrid train makes one")
    forest = load_forest(path)
    require_scene(forest, folder.scene_name, folder.scene_hash, path)
    return SplatRenderer(forest)


def _views(folder: PosedFolder) -> list[View]:
    """The views of the held-out frames, or of the training ones if none is held out."""
    return [View(image.camera, image.time) for image in folder.held_out or folder.training]


def view_of(
    folder: PosedFolder, number: int, camera: Camera | None, size: tuple[int, int] | None, time: float | None
) -> View:
    """The view of that number, with the camera, size and time that were given instead of its own."""
    views = _views(folder)
    if not 0 <= number < len(views):
        raise UserError(f"--view {number}: {folder.folder} has views 0 to {len(views) - 1}")
    view = views[number]
    return View(o.sized(camera or view.camera, size), view.time if time is None else time)


def render_splats(
    output: Path, detail: Path | None, eyes: float | None, renderer: SplatRenderer, settings: FrameSettings
) -> dict[str, Any]:
    """Renders and writes one frame of splats alone, or one per eye; returns what was measured."""
    # A forest alone knows no depth.
    settings = replace(settings, aovs=("splat",) if aovs_of_file(output) else ())
    assert settings.camera is not None
    return splat_facts(settings, settings.camera) | write_frames(
        output,
        detail,
        settings.camera,
        eyes,
        lambda camera: renderer.frame(replace(settings, camera=camera)),
        lambda frame: {"nodes_drawn": frame.nodes_drawn, "milliseconds": frame.milliseconds},
    )


def render_views(
    output: Path,
    folder: PosedFolder,
    renderer: SplatRenderer,
    settings: FrameSettings,
    size: tuple[int, int] | None,
    trace: GazeTrace | AngularTrace | None,
    fps: int,
) -> dict[str, Any]:
    """Renders and writes a video along a folder's views, ordered by time; returns what was measured."""
    from hybrid.render.image_files import check_video
    from hybrid.render.video import ViewPath, render_splat_video

    first, *others = sorted(_views(folder), key=lambda view: view.time)
    camera = first.camera
    # Videos have even sides.
    camera = o.sized(camera, size or (camera.width - camera.width % 2, camera.height - camera.height % 2))
    check_video(camera.width, camera.height)
    path = ViewPath([View(camera, first.time), *others])
    on_frame = None if trace is None else trace.on(settings.display, camera.width, camera.height)
    seconds = _SECONDS if on_frame is None else on_frame.duration
    with progress_bar("video (frames)") as bar:
        times = render_splat_video(output, renderer, settings, path, seconds, fps, bar, on_frame)
    print(f"{output}: {len(times)} frames of {camera.width} x {camera.height}")
    return splat_facts(replace(settings, time=first.time), camera) | {"fps": fps, "frames": times}


def splat_facts(settings: FrameSettings, camera: Camera) -> dict[str, Any]:
    """What `--json` says of frames of any kind."""
    return {
        "width": camera.width,
        "height": camera.height,
        "time": settings.time,
        "acuity_model": settings.acuity_model,
        "pixels_per_degree": settings.display.pixels_per_degree,
    }
