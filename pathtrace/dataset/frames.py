"""The frame set: a folder with transforms.json and one multi-channel OpenEXR file per frame.

The layout follows the Nerfstudio / instant-ngp convention, so that other people's tools open it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.camera.serialization import camera_from_json

FORMAT_VERSION = 2


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
