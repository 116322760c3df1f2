"""The frame set: a folder with transforms.json and one multi-channel OpenEXR file per frame.

The layout follows the Nerfstudio / instant-ngp convention, so that other people's tools open it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from compose.errors import UserError
from compose.files import write_whole
from compose.view import Camera, camera_from_json

Image = NDArray[np.float32]
FORMAT_VERSION = 2


@dataclass(frozen=True)
class Frame:
    """One captured view.

    Attributes:
        radiance: (H, W, 3) linear, denoised.
        albedo: (H, W, 3).
        normal: (H, W, 3) shading normal in world space.
        depth: (H, W) along the view axis to the first surface, inf where nothing is hit.
        unfolded: (H, W) distance along the ray, continued through mirrors, inf where nothing is hit.
        shape: (H, W) int32 shape index, -1 where nothing is hit.
    """

    radiance: Image
    albedo: Image
    normal: Image
    depth: Image
    unfolded: Image
    shape: NDArray[np.int32]


@dataclass(frozen=True)
class Estimate:
    """A view traced with few samples, as it comes from the tracer.

    Attributes:
        radiance: (H, W, 3) linear, not denoised.
        albedo: (H, W, 3), of the same samples.
        normal: (H, W, 3), of the same samples.
    """

    radiance: Image
    albedo: Image
    normal: Image


@dataclass(frozen=True)
class FrameEntry:
    """What a frame set says of a frame.

    Attributes:
        camera: the view.
        file: its Frame.
        samples: per pixel.
        held_out: training must not see it.
        estimates: samples per pixel and file of estimates of the same view, where there are any.
    """

    camera: Camera
    file: Path
    samples: int
    held_out: bool
    estimates: dict[int, Path]


def write_frame(path: Path, frame: Frame) -> None:
    """Writes one frame; the file appears whole or not at all."""
    single = np.float32
    channels: dict[str, Any] = {
        **_shaded(frame),
        "Z": np.ascontiguousarray(frame.depth, dtype=single),
        "unfolded.V": np.ascontiguousarray(frame.unfolded, dtype=single),
        # OpenEXR knows no signed integers: 0 is "nothing hit".
        "shape.V": (frame.shape + 1).astype(np.uint32),
    }
    _write(path, channels)


def write_estimate(path: Path, estimate: Estimate) -> None:
    """Writes one estimate; the file appears whole or not at all."""
    _write(path, _shaded(estimate))


def read_frame(path: Path) -> Frame:
    """Inverse of write_frame.

    Raises:
        UserError: the file is missing, damaged, or not a frame of a frame set.
    """
    planes = _read(path)
    try:
        return Frame(
            *_shading(planes),
            planes["Z"],
            planes["unfolded.V"],
            planes["shape.V"].astype(np.int32) - 1,
        )
    except KeyError as error:
        raise _unreadable(path, error) from error


def read_estimate(path: Path) -> Estimate:
    """Inverse of write_estimate.

    Raises:
        UserError: the file is missing, damaged, or not an estimate of a frame set.
    """
    planes = _read(path)
    try:
        return Estimate(*_shading(planes))
    except KeyError as error:
        raise _unreadable(path, error) from error


def _write(path: Path, channels: dict[str, Any]) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    write_whole(path, lambda part: OpenEXR.File(header, channels).write(str(part)))


def _read(path: Path) -> dict[str, Any]:
    try:
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
        return {name: channel.pixels for name, channel in channels.items()}
    except (OSError, RuntimeError, ValueError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> UserError:
    return UserError(f"{path}: not a readable frame ({error}); capture it again")


def _shaded(image: Frame | Estimate) -> dict[str, Any]:
    return {
        **_planes("", "RGB", image.radiance, np.float32),
        **_planes("albedo.", "RGB", image.albedo, np.float16),
        **_planes("normal.", "XYZ", image.normal, np.float16),
    }


def _shading(planes: dict[str, Any]) -> tuple[Image, Image, Image]:
    stack = lambda prefix, names: np.stack(  # noqa: E731
        [planes[prefix + n] for n in names], axis=-1
    ).astype(np.float32)
    return stack("", "RGB"), stack("albedo.", "RGB"), stack("normal.", "XYZ")


def _planes(prefix: str, names: str, image: Image, dtype: Any) -> dict[str, Any]:
    return {prefix + n: np.ascontiguousarray(image[..., i], dtype=dtype) for i, n in enumerate(names)}


@dataclass(frozen=True)
class FrameSet:
    """A captured folder.

    Attributes:
        folder: where it lies.
        digest: hash of its description.
        scene_name, scene_hash: what the frames show.
        entries: the frames.
        close_ups: parts of held-out frames at a multiple of their resolution.
    """

    folder: Path
    digest: str
    scene_name: str
    scene_hash: str
    entries: list[FrameEntry]
    close_ups: list[FrameEntry]

    @property
    def training(self) -> list[FrameEntry]:
        return [entry for entry in self.entries if not entry.held_out]

    @property
    def held_out(self) -> list[FrameEntry]:
        return [entry for entry in self.entries if entry.held_out]


def read_frame_set(folder: Path) -> FrameSet:
    """Reads transforms.json and checks that every frame it names is there.

    Raises:
        UserError: the folder is not a frame set, or its capture was not finished.
    """
    path = folder / "transforms.json"
    if not path.is_file():
        raise UserError(f"{folder}: not a frame set (no transforms.json); make one with: hybrid capture")
    try:
        text = path.read_text()
        document = json.loads(text)
        if document["format_version"] != FORMAT_VERSION:
            raise UserError(
                f"{path}: format version {document['format_version']}, this program reads {FORMAT_VERSION}; "
                "capture the frames again"
            )
        entries, close_ups = (
            [_entry(folder, {**document, **frame}) for frame in document[name]]
            for name in ("frames", "close_ups")
        )
        scene = document["scene"]["name"], document["scene"]["hash"]
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: not a frame set's description ({error!r})") from error
    files = [file for entry in entries + close_ups for file in (entry.file, *entry.estimates.values())]
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise UserError(
            f"{folder}: {len(missing)} of {len(files)} files are missing ({missing[0]} first); "
            "run hybrid capture again with the same options, it goes on where it stopped"
        )
    return FrameSet(folder, hashlib.sha256(text.encode()).hexdigest(), *scene, entries, close_ups)


def _entry(folder: Path, frame: dict[str, Any]) -> FrameEntry:
    return FrameEntry(
        camera_from_json(frame),
        folder / frame["file_path"],
        int(frame["samples"]),
        bool(frame["held_out"]),
        {int(e["samples"]): folder / e["file_path"] for e in frame["estimates"]},
    )
