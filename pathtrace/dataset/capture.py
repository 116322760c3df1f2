"""Captures a frame set: views chosen in free space, traced, denoised, written one by one.

Which frames there are, and how each is rendered, stands in transforms.json. Its names follow the Nerfstudio /
instant-ngp convention, so that other programs can read the file.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from compose.base.files import read_json, write_whole
from compose.camera.coordinate_systems import WORLD, camera_from_json, camera_to_json
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.dataset.captured_frames import is_intact, read_frame, render_frame, write_frame
from pathtrace.dataset.frame_set import FORMAT_VERSION, CaptureSettings, FrameSet, read_frame_set
from pathtrace.region.neighbourhood import ViewSet, choose_views, monocular_views
from pathtrace.scene.scene import Scene
from pathtrace.trace import Integrator
from pathtrace.trace.tracer import Tracer

_DESCRIPTION = "transforms.json"
# Keeps the seeds of different captures apart: far more than one capture has frames.
_CAPTURE_SEED_STEP = 100_003


def describe_capture(
    scene: Scene, views: ViewSet, settings: CaptureSettings, integrator: Integrator
) -> dict[str, Any]:
    """The content of transforms.json, for an integrator of all but held-out frames, which are unbiased.

    UserError if more views are held out than may be.
    """
    cameras, count, most = views.fixed + views.spread, settings.held_out, len(views.spread)
    if count > most:
        raise UserError(f"held-out {count}: must be at most {most}, the views that may be held out")
    step = most / max(1, count)
    held_out = {len(views.fixed) + round((i + 1) * step) - 1 for i in range(count)}
    frames = [
        {
            "file_path": f"frames/{index:04d}.exr",
            "transform_matrix": camera_to_json(camera)["transform_matrix"],
            "time": views.times[index],
            "samples": settings.held_out_spp if index in held_out else settings.spp,
            "held_out": index in held_out,
        }
        for index, camera in enumerate(cameras)
    ]
    # As captures had them when there were no other views.
    described = asdict(settings)
    for name in ("monocular", "fov"):
        if not described[name]:
            del described[name]
    intrinsics = camera_to_json(cameras[0])
    del intrinsics["transform_matrix"]
    return {
        "camera_model": "OPENCV",
        **intrinsics,
        **described_set(scene, described, integrator.value),
        "frames": frames,
    }


def described_set(scene: Scene, settings: dict[str, Any], integrator: str) -> dict[str, Any]:
    """What transforms.json says of all frames: of their scene, what moves in it, and how it is traced."""
    place = {} if scene.place == WORLD else asdict(scene.place)
    plan = {"plan": dict(scene.plan)} if scene.plan else {}
    motion = {} if scene.moving is None else {"courses": [c.as_json() for c in scene.moving.courses()]}
    return {
        "format_version": FORMAT_VERSION,
        "scene": {"name": scene.name, "hash": scene.hash, "max_depth": scene.max_depth, **place, **plan},
        "settings": settings,
        "integrator": integrator,
        **motion,
    }


def write_description(folder: Path, document: dict[str, Any]) -> None:
    """Writes transforms.json and makes the folder of the frames; keeps an equal file, refuses others."""
    path = folder / _DESCRIPTION
    text = json.dumps(document, indent=1)
    if not path.is_file():
        write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))
        # Whoever writes a frame says what is wrong there.
        with contextlib.suppress(OSError):
            (folder / "frames").mkdir(exist_ok=True)
        return
    try:
        found = read_json(path)
    except (OSError, ValueError) as error:
        raise UserError(
            f"{path}: is damaged ({error}); delete it and capture with the same settings again"
        ) from error
    if found != json.loads(text):
        raise UserError(f"{folder}: holds another capture; choose another folder or the same settings")


def capture(
    scene: Scene,
    folder: Path,
    settings: CaptureSettings,
    progress: Callable[[int, int], None],
    cache: IrradianceCache | None = None,
) -> FrameSet:
    """Captures a frame set of a scene to train on, into a folder; resumes if it was interrupted.

    Views lie in free space around the scene's own camera, which is the first of them. The held-out ones are
    spaced evenly over the others, and unbiased. Of a scene that moves, views have times of their own; a
    monocular capture is that of one camera, which sways around the scene's own.

    The folder gets a `transforms.json` and one OpenEXR file per frame. Intact files are not rendered again; a
    resumed capture ends with the same files as one that was not interrupted.

    Args:
        scene, folder, settings: what is captured, where to, and how.
        progress: called after each frame with the number of samples done and their total.
        cache: in which the paths of training frames end; without it, these are unbiased as well.

    Raises:
        UserError: the folder holds another capture or cannot be written; the scene's own camera sees no
            surface; there is no free space for that many views; or more views are held out than may be.

    Examples:
        >>> settings = CaptureSettings(views=40, held_out=4, spp=16, held_out_spp=64)
        >>> frames = capture(load_scene("room"), Path("frames"), settings, lambda done, total: None)
        >>> len(frames.training), len(frames.held_out)
        (40, 4)
    """
    integrator = Integrator.PATH if cache is None else Integrator.CACHED
    render_share(scene, folder, chosen_capture(scene, settings, integrator), progress, cache)
    return read_frame_set(folder)


def chosen_capture(scene: Scene, settings: CaptureSettings, integrator: Integrator) -> dict[str, Any]:
    """As `describe_capture`, of views chosen as `capture` does; raises as it does."""
    count = settings.views + settings.held_out
    # The free space is that of the beginning, whatever the scene has shown last.
    scene.show(0.0)
    size, surfaces = (settings.width, settings.height), scene.surfaces()
    if settings.fov is not None:
        scene = replace(scene, camera=scene.camera.resized(*size).seeing(settings.fov))
    if settings.monocular:
        views = monocular_views(scene, surfaces, count, *size)
    else:
        views = choose_views(scene, surfaces, count, *size, settings.seed)
    return describe_capture(scene, views, settings, integrator)


def render_share(
    scene: Scene,
    folder: Path,
    document: dict[str, Any],
    progress: Callable[[int, int], None],
    cache: IrradianceCache | None = None,
    takes: Callable[[int], bool] = lambda number: True,
) -> None:
    """Renders the frames of a described capture that `takes` wants, by their number from the most costly.

    They are the same, whatever else is rendered. Progress counts their samples; raises as `capture` does.
    """
    write_description(folder, document)
    unbiased, quick = Tracer(scene), Tracer(scene, cache=cache)
    entries = document["frames"]
    cameras = [camera_from_json({**document, **entry}) for entry in entries]
    samples = [
        entry["samples"] * camera.width * camera.height
        for entry, camera in zip(entries, cameras, strict=True)
    ]
    # Held-out frames cost most and come at regular intervals: by index, one share might get them all.
    by_cost = sorted(range(len(entries)), key=lambda index: -samples[index])
    share = sorted(index for number, index in enumerate(by_cost) if takes(number))
    done, total = 0, sum(samples[index] for index in share)
    for index in share:
        entry, camera = entries[index], cameras[index]
        file = folder / entry["file_path"]
        if not is_intact(read_frame, file, camera):
            # Each frame has a seed of its own, so that a resumed capture ends with the same frames.
            seed = document["settings"]["seed"] * _CAPTURE_SEED_STEP + index
            scene.show(entry["time"])
            tracer = unbiased if entry["held_out"] else quick
            write_frame(file, render_frame(tracer, camera, entry["samples"], seed))
        done += samples[index]
        progress(done, total)


def join_shares(folder: Path, shares: Sequence[Path]) -> FrameSet:
    """Makes a frame set of the folders of all shares of one capture, whose files move into it.

    If interrupted, it goes on. UserError, before anything is moved, if the shares are of different captures,
    or a file is missing.
    """
    text = (shares[0] / _DESCRIPTION).read_text(encoding="utf-8")
    for share in shares:
        if (share / _DESCRIPTION).read_text(encoding="utf-8") != text:
            raise UserError(f"{share}: holds another capture than {shares[0]}")
    document = json.loads(text)
    names = [entry["file_path"] for entry in document["frames"]]
    places = {name: place for place in (*shares, folder) for name in names if (place / name).is_file()}
    if missing := [name for name in names if name not in places]:
        raise UserError(
            f"{folder}: {len(missing)} of {len(names)} files are in no part ({missing[0]} first); "
            "run the parts again"
        )
    (folder / "frames").mkdir(exist_ok=True)
    for name, place in places.items():
        if place != folder:
            os.replace(place / name, folder / name)
    # Last: a folder without it is no frame set.
    write_description(folder, document)
    return read_frame_set(folder)
