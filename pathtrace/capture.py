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
from pathtrace.frames import (
    FORMAT_VERSION,
    Estimate,
    Frame,
    FrameSet,
    read_frame_set,
    write_estimate,
    write_frame,
)
from pathtrace.scene import Scene
from pathtrace.surface import Surfaces
from pathtrace.tracer import Tracer, frame_positions
from pathtrace.views import ViewSet, choose_views

# Samples per pixel of the estimates that are kept of some held-out views: what a fovea may be traced with.
_ESTIMATES = (1, 2, 4, 16, 64)


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
            counts = {e["samples"]: folder / e["file_path"] for e in entry["estimates"]}
            seed = settings.seed * 100_003 + index
            frame, estimates = render_estimates(tracer, camera, entry["samples"], seed, tuple(counts))
            for file, estimate in zip(counts.values(), estimates, strict=True):
                write_estimate(file, estimate)
            write_frame(path, frame)
        done += entry["samples"]
        progress(done, total)
    return read_frame_set(folder)


def render_frame(tracer: Tracer, camera: Camera, spp: int, seed: int) -> Frame:
    """One denoised frame with everything that training wants to know of it."""
    return render_estimates(tracer, camera, spp, seed, ())[0]


def render_estimates(
    tracer: Tracer, camera: Camera, spp: int, seed: int, counts: tuple[int, ...]
) -> tuple[Frame, list[Estimate]]:
    """One denoised frame, and estimates from disjoint parts of its samples, each of so many per pixel."""
    positions = frame_positions(camera)
    hits = tracer.hits(camera, positions)
    shape = (camera.height, camera.width)
    image = lambda channels: np.stack([c.numpy() for c in channels], axis=-1).reshape(*shape, 3)  # noqa: E731
    parts = []
    for number, count in enumerate((*counts, spp - sum(counts))):
        traced = tracer.trace(camera, positions, count, seed + number * 1_000_033, guides=True)
        parts.append(Estimate(image(traced.radiance), image(traced.albedo), image(traced.normal)))
    weights = np.array((*counts, spp - sum(counts)), dtype=np.float32) / spp
    mean = lambda name: sum(  # noqa: E731
        weight * getattr(part, name) for weight, part in zip(weights, parts, strict=True)
    )
    radiance, albedo, normal = mean("radiance"), mean("albedo"), mean("normal")
    cosine = (camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]).astype(np.float32)
    frame = Frame(
        denoise(radiance, albedo, normal),
        albedo,
        normal,
        (hits.distance * cosine).reshape(shape),
        hits.unfolded.reshape(shape),
        hits.shape.reshape(shape),
    )
    return frame, parts[:-1]


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
    # Every third held-out view is kept from fitting the fusion as well.
    fitted = {index for number, index in enumerate(sorted(held_out)) if number % 3 != 2}
    # Half of a reference's samples at most.
    counts = [n for i, n in enumerate(_ESTIMATES) if 2 * sum(_ESTIMATES[: i + 1]) <= settings.held_out_spp]
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
                "estimates": [
                    {"samples": count, "file_path": f"frames/{index:04d}-{count}.exr"}
                    for count in counts
                    if index in fitted
                ],
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
