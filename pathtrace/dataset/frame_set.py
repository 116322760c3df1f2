"""The frame set: a folder with transforms.json and one multi-channel OpenEXR file per frame; settings of it.

The layout follows the Nerfstudio / instant-ngp convention, so that other programs can read it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from compose.base.errors import (
    UserError,
    as_plain_numbers,
    claimed_scene,
    file_inside,
    one_line,
    require_seed,
)
from compose.base.files import MOST_BYTES, parse_json, require_size_below
from compose.camera.camera import Camera
from compose.camera.coordinate_systems import camera_from_json
from pathtrace.scene.courses import Course, course_from_json

FORMAT_VERSION = 3


@dataclass(frozen=True)
class FrameEntry:
    """A frame of a frame set."""

    camera: Camera  # the view
    file: Path  # its EXR file, a captured frame
    samples: int  # samples per pixel
    held_out: bool  # whether training must not see it
    time: float = 0.0  # that it shows, from 0 to 1

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels of the view, and of its file."""
        return self.camera.width, self.camera.height


@dataclass(frozen=True)
class FrameSet:
    """A complete frame set.

    Attributes:
        folder: its folder.
        digest: SHA-256 of its transforms.json.
        scene_name, scene_hash: the scene that the frames show.
        entries: the frames, training and held-out ones.
        integrator: name of the one that training frames were traced with.
        courses: of the shapes that move rigidly.
        plan: what was planned for the scene, by name.
    """

    folder: Path
    digest: str
    scene_name: str
    scene_hash: str
    entries: list[FrameEntry]
    integrator: str
    courses: tuple[Course, ...] = ()
    plan: Mapping[str, Any] = field(default_factory=dict)

    @property
    def training(self) -> list[FrameEntry]:
        """Frames to train on."""
        return [entry for entry in self.entries if not entry.held_out]

    @property
    def held_out(self) -> list[FrameEntry]:
        """Frames that training must not see."""
        return [entry for entry in self.entries if entry.held_out]


def read_frame_set(folder: Path) -> FrameSet:
    """Reads a frame set's transforms.json and checks that every file it names exists.

    UserError if the folder is no frame set, has another format version, or its capture is not complete.
    """
    path = folder / "transforms.json"
    if not path.is_file():
        raise UserError(f"{folder}: not a frame set (no transforms.json); make one with: hybrid capture")
    try:
        require_size_below(path, MOST_BYTES)
        text = path.read_text(encoding="utf-8")
        document = parse_json(text)
        if document["format_version"] != FORMAT_VERSION:
            raise UserError(
                f"{path}: format version {document['format_version']}, this program reads {FORMAT_VERSION}; "
                "capture the frames again"
            )
        entries = [_entry(folder, {**document, **frame}) for frame in document["frames"]]
        described = document["scene"]
        scene = claimed_scene(described["name"], described["hash"])
        integrator, plan = str(document["integrator"]), dict(described.get("plan", {}))
        courses = tuple(course_from_json(course) for course in document.get("courses", ()))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: not the description of a frame set ({one_line(repr(error))})") from error
    digest = hashlib.sha256(text.encode()).hexdigest()
    found = FrameSet(folder, digest, *scene, entries, integrator, courses, plan)
    files = [entry.file for entry in entries]
    if missing := [file.name for file in files if not file.is_file()]:
        raise UserError(
            f"{folder}: {len(missing)} of {len(files)} files are missing ({missing[0]} first); "
            "run hybrid capture again with the same settings to resume it"
        )
    return found


def _entry(folder: Path, frame: dict[str, Any]) -> FrameEntry:
    """An entry from its JSON, with the document's intrinsics where it has none of its own."""
    return FrameEntry(
        camera_from_json(frame),
        file_inside(folder, frame["file_path"]),
        _samples(frame),
        bool(frame["held_out"]),
        time_of(frame),
    )


def time_of(frame: dict[str, Any]) -> float:
    """The time that a frame shows, 0 by default; ValueError if it is not from 0 to 1."""
    time = float(frame.get("time", 0.0))
    if not 0 <= time <= 1:
        raise ValueError(f"time {time:g}: must be from 0 to 1")
    return time


def _samples(entry: dict[str, Any]) -> int:
    """Samples per pixel; ValueError if that is no positive number of 32 bits."""
    count = int(entry["samples"])
    if not 0 < count < 2**32:
        raise ValueError(f"samples {count:.6g}: must be positive, with 32 bits")
    return count


@dataclass(frozen=True)
class CaptureSettings:
    """Settings of a capture; UserError for a seed, ValueError for a number that is out of range.

    Attributes:
        views: number of training views.
        held_out: number of further views, may be 0; nothing is fitted to them.
        width, height: frame size in pixels.
        spp: samples per pixel of a training view, which is denoised afterwards.
        held_out_spp: samples per pixel of a held-out view, which is denoised as well.
        seed: same seed, same frames; from 0 to compose.base.errors.MOST_SEED.
        monocular: whether views are those of one camera that sways around the scene's own, one instant after
            the other; otherwise they are free, and each shows a time of its own.
        fov: horizontal field of view in degrees, over 0 and under 180; None for that of the scene's camera.
    """

    views: int = 64
    held_out: int = 8
    width: int = 256
    height: int = 256
    spp: int = 32
    held_out_spp: int = 256
    seed: int = 0
    monocular: bool = False
    fov: float | None = None

    def __post_init__(self) -> None:
        as_plain_numbers(self)
        for name in ("views", "width", "height", "spp", "held_out_spp"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name.replace('_', '-')} is {getattr(self, name)}; must be positive")
        if self.held_out < 0:
            raise ValueError(f"held-out is {self.held_out}; must not be negative")
        if self.fov is not None and not 0 < self.fov < 180:
            raise ValueError(f"fov is {self.fov}; must be over 0 and under 180 degrees")
        require_seed(self.seed)
