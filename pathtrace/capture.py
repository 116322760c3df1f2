"""Renders a frame set: views chosen in free space, traced, denoised, written one by one."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compose.errors import UserError
from compose.files import write_whole
from compose.view import Camera, camera_to_json
from pathtrace.denoise import denoise
from pathtrace.frames import FORMAT_VERSION, Frame, FrameSet, read_frame_set, write_frame
from pathtrace.scene import Scene
from pathtrace.surface import Surfaces
from pathtrace.tracer import Tracer, frame_positions
from pathtrace.views import ViewSet, choose_views


@dataclass(frozen=True)
class CaptureSettings:
    """What is captured.

    Attributes:
        views: training views.
        held_out: further views that training never sees.
        width, height: frame size in pixels.
        spp: samples per pixel of a training view; denoised afterwards.
        held_out_spp: samples per pixel of a held-out view; denoised as well.
        seed: same seed, same frames.

    Raises:
        ValueError: a count or a size is not positive.
    """

    views: int = 64
    held_out: int = 8
    width: int = 256
    height: int = 256
    spp: int = 32
    held_out_spp: int = 256
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("views", "width", "height", "spp", "held_out_spp"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name.replace('_', '-')} is {getattr(self, name)}; must be positive")
        if self.held_out < 0:
            raise ValueError(f"held-out is {self.held_out}; must not be negative")


def capture(
    scene: Scene, folder: Path, settings: CaptureSettings, progress: Callable[[int, int], None]
) -> FrameSet:
    """Renders what is missing of a frame set; an interrupted capture goes on where it stopped.

    Args:
        scene: what to render.
        folder: where to; made if it does not exist.
        settings: which frames.
        progress: called with (samples done, samples in all).

    Raises:
        UserError: the folder holds another capture or cannot be written.
    """
    chosen = choose_views(
        scene,
        Surfaces(scene),
        settings.views + settings.held_out,
        settings.width,
        settings.height,
        settings.seed,
    )
    cameras = chosen.fixed + chosen.spread
    document = _describe(scene, cameras, _held_out(chosen, settings.held_out), settings)
    _write_description(folder, document)
    tracer = Tracer(scene)
    total = sum(frame["samples"] for frame in document["frames"])
    done = 0
    for index, (camera, entry) in enumerate(zip(cameras, document["frames"], strict=True)):
        path = folder / entry["file_path"]
        if not path.is_file():
            # The frame's own seed: a capture that was interrupted ends with the very same frames.
            write_frame(path, render_frame(tracer, camera, entry["samples"], settings.seed * 100_003 + index))
        done += entry["samples"]
        progress(done, total)
    return read_frame_set(folder)


def render_frame(tracer: Tracer, camera: Camera, spp: int, seed: int) -> Frame:
    """One denoised frame with everything that training wants to know of it."""
    positions = frame_positions(camera)
    traced = tracer.trace(camera, positions, spp, seed, guides=True)
    hits = tracer.hits(camera, positions)
    shape = (camera.height, camera.width)
    image = lambda channels: np.stack([c.numpy() for c in channels], axis=-1).reshape(*shape, 3)  # noqa: E731
    albedo, normal = image(traced.albedo), image(traced.normal)
    axis = camera.camera_to_world[:3, 2]
    cosine = (camera.rays(camera.pixel_centres()) @ axis).astype(np.float32)
    return Frame(
        denoise(image(traced.radiance), albedo, normal),
        albedo,
        normal,
        (hits.distance * cosine).reshape(shape),
        hits.unfolded.reshape(shape),
        hits.shape.reshape(shape),
    )


def _held_out(views: ViewSet, count: int) -> set[int]:
    """Indices of the views that training must not see, evenly over those that are spread."""
    if count > len(views.spread):
        raise UserError(f"--held-out {count}: more than the {len(views.spread)} views that may be held out")
    step = len(views.spread) / max(1, count)
    return {len(views.fixed) + round((i + 1) * step) - 1 for i in range(count)}


def _describe(
    scene: Scene, cameras: list[Camera], held_out: set[int], settings: CaptureSettings
) -> dict[str, Any]:
    """The content of transforms.json."""
    frames = []
    for index, camera in enumerate(cameras):
        pose = camera_to_json(camera)
        frames.append(
            {
                "file_path": f"frames/{index:04d}.exr",
                "transform_matrix": pose["transform_matrix"],
                "time": 0.0,
                "samples": settings.held_out_spp if index in held_out else settings.spp,
                "held_out": index in held_out,
            }
        )
    intrinsics = {k: v for k, v in camera_to_json(cameras[0]).items() if k != "transform_matrix"}
    return {
        "camera_model": "OPENCV",
        **intrinsics,
        "format_version": FORMAT_VERSION,
        "scene": {"name": scene.name, "hash": scene.hash, "max_depth": scene.max_depth},
        "settings": asdict(settings),
        "frames": frames,
    }


def _write_description(folder: Path, document: dict[str, Any]) -> None:
    path = folder / "transforms.json"
    text = json.dumps(document, indent=1)
    if path.is_file():
        if path.read_text() != text:
            raise UserError(f"{folder}: holds another capture; choose another folder or the same options")
        return
    write_whole(path, lambda part: part.write_text(text))
    (folder / "frames").mkdir(exist_ok=True)
