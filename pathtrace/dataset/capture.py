"""Renders a frame set: views chosen in free space, traced, denoised, written one by one."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.errors import UserError
from compose.base.files import write_whole
from compose.camera.camera import Camera
from compose.camera.serialization import camera_from_json, camera_to_json
from pathtrace.base.denoise import denoise
from pathtrace.dataset.exr import Estimate, Frame, write_estimate, write_frame
from pathtrace.dataset.frames import FORMAT_VERSION, FrameSet, read_frame_set
from pathtrace.dataset.views import ViewSet, choose_views
from pathtrace.scene.scene import Scene
from pathtrace.scene.surfaces import Surfaces
from pathtrace.trace.film import frame_positions, interleaved
from pathtrace.trace.tracer import Tracer, auxiliary_spp

# Samples per pixel of the estimates that are kept of some held-out views: what a fovea may be traced with.
_ESTIMATES = (1, 2, 4, 16, 64)
# Of those views, parts are rendered at so many times the resolution, half as wide and high as the view.
_CLOSER = (2, 4)


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
        progress: called with samples done and samples in all.

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
    document = _describe(scene, cameras, chosen, settings)
    _write_description(folder, document)
    tracer = Tracer(scene)
    entries = document["frames"] + document["close_ups"]
    views = [camera_from_json({**document, **entry}) for entry in entries]
    samples = [
        entry["samples"] * view.width * view.height for entry, view in zip(entries, views, strict=True)
    ]
    for index, (entry, camera) in enumerate(zip(entries, views, strict=True)):
        path = folder / entry["file_path"]
        if not path.is_file():
            # The frame's own seed: a capture that was interrupted ends with the very same frames.
            counts = {e["samples"]: folder / e["file_path"] for e in entry["estimates"]}
            seed = settings.seed * 100_003 + index
            frame, estimates = render_estimates(tracer, camera, entry["samples"], seed, tuple(counts))
            for file, estimate in zip(counts.values(), estimates, strict=True):
                write_estimate(file, estimate)
            write_frame(path, frame)
        progress(sum(samples[: index + 1]), sum(samples))
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
    image = lambda channels: interleaved(channels).reshape(*shape, 3)  # noqa: E731
    parts = []
    for number, count in enumerate((*counts, spp - sum(counts))):
        part_seed = seed + number * 1_000_033
        traced = tracer.trace(camera, positions, count, part_seed)
        auxiliary = tracer.auxiliary(camera, positions, auxiliary_spp(count), part_seed)
        parts.append(Estimate(image(traced.radiance), image(auxiliary.albedo), image(auxiliary.normal)))
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
    scene: Scene, cameras: list[Camera], chosen: ViewSet, settings: CaptureSettings
) -> dict[str, Any]:
    """The content of transforms.json."""
    held_out = _held_out(chosen, settings.held_out)
    # Every third held-out view is kept from fitting the fusion as well.
    fitted = {index for number, index in enumerate(sorted(held_out)) if number % 3 != 2}
    frames = [
        _entry(
            camera,
            f"frames/{index:04d}",
            settings.held_out_spp if index in held_out else settings.spp,
            _counts(settings.held_out_spp) if index in fitted else [],
            index in held_out,
        )
        for index, camera in enumerate(cameras)
    ]
    rng = np.random.default_rng(settings.seed)
    close_ups = []
    for index in sorted(fitted):
        for factor in _CLOSER:
            camera = _part_of(cameras[index], factor, rng)
            path = f"frames/{index:04d}-closer{factor}"
            entry = _entry(camera, path, settings.held_out_spp, _counts(settings.held_out_spp), True)
            close_ups.append({**entry, **_intrinsics(camera)})
    return {
        "camera_model": "OPENCV",
        **_intrinsics(cameras[0]),
        "format_version": FORMAT_VERSION,
        "scene": {"name": scene.name, "hash": scene.hash, "max_depth": scene.max_depth},
        "settings": asdict(settings),
        "frames": frames,
        # Apart from the frames, which other programs take for training.
        "close_ups": close_ups,
    }


def _entry(camera: Camera, path: str, spp: int, counts: list[int], held_out: bool) -> dict[str, Any]:
    return {
        "file_path": f"{path}.exr",
        "transform_matrix": camera_to_json(camera)["transform_matrix"],
        "time": 0.0,
        "samples": spp,
        "held_out": held_out,
        "estimates": [{"samples": count, "file_path": f"{path}-{count}spp.exr"} for count in counts],
    }


def _counts(spp: int) -> list[int]:
    """Samples per pixel of the estimates: all together half of the reference's at most."""
    return [count for i, count in enumerate(_ESTIMATES) if 2 * sum(_ESTIMATES[: i + 1]) <= spp]


def _part_of(camera: Camera, factor: int, rng: np.random.Generator) -> Camera:
    """Half the view's width and height in pixels, of the view at a multiple of its resolution."""
    large = camera.resized(camera.width * factor, camera.height * factor)
    width, height = max(1, camera.width // 2), max(1, camera.height // 2)
    left, top = int(rng.integers(large.width - width + 1)), int(rng.integers(large.height - height + 1))
    return large.cropped(left, top, width, height)


def _intrinsics(camera: Camera) -> dict[str, Any]:
    return {name: value for name, value in camera_to_json(camera).items() if name != "transform_matrix"}


def _write_description(folder: Path, document: dict[str, Any]) -> None:
    path = folder / "transforms.json"
    text = json.dumps(document, indent=1)
    if path.is_file():
        if path.read_text() != text:
            raise UserError(f"{folder}: holds another capture; choose another folder or the same options")
        return
    write_whole(path, lambda part: part.write_text(text))
    (folder / "frames").mkdir(exist_ok=True)
