"""transforms.json of a capture: which frames there are, and how each is rendered.

The names follow the Nerfstudio / instant-ngp convention, so that other programs can read the file.
"""

from __future__ import annotations

import contextlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.base.files import write_whole
from compose.base.json_file import read_json
from compose.camera.camera import Camera
from compose.camera.place import WORLD
from compose.camera.serialization import camera_to_json
from pathtrace.dataset.frames import FORMAT_VERSION
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.dataset.views import ViewSet
from pathtrace.scene.scene import Scene
from pathtrace.trace.integrator import Integrator

# Samples per pixel of the estimates stored with some held-out views: what a fovea may be traced with.
_ESTIMATE_SPP = (1, 2, 4, 16, 64)


def describe_capture(
    scene: Scene, views: ViewSet, settings: CaptureSettings, integrator: Integrator
) -> dict[str, Any]:
    """The content of transforms.json.

    Args:
        scene, views, settings: what is captured.
        integrator: of training frames and estimates; held-out frames are always unbiased.

    Raises:
        UserError: more views are held out than may be.
    """
    cameras = views.fixed + views.spread
    held_out = _held_out(views, settings.held_out)
    # Every third held-out view is kept from fitting the fusion, too.
    fitted = {index for number, index in enumerate(sorted(held_out)) if number % 3 != 2}
    frames = [
        _entry(
            camera,
            f"frames/{index:04d}",
            settings.held_out_spp if index in held_out else settings.spp,
            _estimate_spp(settings.held_out_spp) if index in fitted else [],
            index in held_out,
            views.times[index],
        )
        for index, camera in enumerate(cameras)
    ]
    rng = np.random.default_rng(settings.seed)
    close_ups = [
        _close_up(cameras[index], index, factor, settings.held_out_spp, views.times[index], rng)
        for index in sorted(fitted)
        for factor in settings.close_ups
    ]
    return {
        "camera_model": "OPENCV",
        **_intrinsics(cameras[0]),
        "format_version": FORMAT_VERSION,
        "scene": described_scene(scene),
        "settings": _described_settings(settings),
        "integrator": integrator.value,
        **described_motion(scene),
        "frames": frames,
        # Not among the frames, all of which other programs would train on.
        "close_ups": close_ups,
    }


def described_scene(scene: Scene) -> dict[str, Any]:
    """The scene in transforms.json, with coordinates if not the world's, and what is planned for it."""
    place = {} if scene.place == WORLD else asdict(scene.place)
    plan = {"plan": dict(scene.plan)} if scene.plan else {}
    return {"name": scene.name, "hash": scene.hash, "max_depth": scene.max_depth, **place, **plan}


def described_motion(scene: Scene) -> dict[str, Any]:
    """What moves rigidly, in transforms.json; nothing of a scene that stands still."""
    return (
        {} if scene.moving is None else {"courses": [course.as_json() for course in scene.moving.courses()]}
    )


def write_description(folder: Path, document: dict[str, Any]) -> None:
    """Writes transforms.json and makes the folder of the frames; keeps an equal file.

    Raises:
        UserError: the folder holds another capture or a damaged file, or cannot be written.
    """
    path = folder / "transforms.json"
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


def _held_out(views: ViewSet, count: int) -> set[int]:
    """Indices of the held-out views among all views, evenly spaced over the spread ones."""
    if count > len(views.spread):
        raise UserError(
            f"held-out {count}: must be at most {len(views.spread)}, the views that may be held out"
        )
    step = len(views.spread) / max(1, count)
    return {len(views.fixed) + round((i + 1) * step) - 1 for i in range(count)}


def _described_settings(settings: CaptureSettings) -> dict[str, Any]:
    """The settings; of free views as captures had them when there were no others."""
    found = {**asdict(settings), "close_ups": list(settings.close_ups)}
    if not settings.monocular:
        del found["monocular"]
    return found


def _entry(
    camera: Camera, path: str, spp: int, estimate_spp: list[int], held_out: bool, time: float
) -> dict[str, Any]:
    """A frame of transforms.json; `path` has no extension."""
    return {
        "file_path": f"{path}.exr",
        "transform_matrix": camera_to_json(camera)["transform_matrix"],
        "time": time,
        "samples": spp,
        "held_out": held_out,
        "estimates": [{"samples": count, "file_path": f"{path}-{count}spp.exr"} for count in estimate_spp],
        "halves": [f"{path}-half{number}.exr" for number in (1, 2)] if estimate_spp else [],
    }


def _close_up(
    camera: Camera, index: int, factor: int, spp: int, time: float, rng: np.random.Generator
) -> dict[str, Any]:
    """A held-out view's close-up in transforms.json, with its own intrinsics."""
    part = _part_of(camera, factor, rng)
    entry = _entry(part, f"frames/{index:04d}-closer{factor}", spp, _estimate_spp(spp), True, time)
    return {**entry, **_intrinsics(part)}


def _estimate_spp(spp: int) -> list[int]:
    """Samples per pixel of a view's estimates, in all at most half of the view's own."""
    return [count for i, count in enumerate(_ESTIMATE_SPP) if 2 * sum(_ESTIMATE_SPP[: i + 1]) <= spp]


def _part_of(camera: Camera, factor: int, rng: np.random.Generator) -> Camera:
    """A random part of a view at a multiple of its resolution, half as many pixels wide and high."""
    large = camera.resized(camera.width * factor, camera.height * factor)
    width, height = max(1, camera.width // 2), max(1, camera.height // 2)
    left, top = int(rng.integers(large.width - width + 1)), int(rng.integers(large.height - height + 1))
    return large.cropped(left, top, width, height)


def _intrinsics(camera: Camera) -> dict[str, Any]:
    return {name: value for name, value in camera_to_json(camera).items() if name != "transform_matrix"}
