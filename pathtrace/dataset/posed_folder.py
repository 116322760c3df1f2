"""Recognizes the layout of a folder of posed images, and reads it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from compose.base.errors import UserError, claimed_scene, one_line
from pathtrace.dataset.posed_images import PosedFolder, PosedImage
from pathtrace.dataset.posed_layouts import (
    DATASET,
    NERFIES,
    SYNTHETIC,
    TRAINING,
    read_nerfies,
    read_synthetic,
)

# Name of a scene whose folder has one that no scene can have.
_UNNAMED = "frames"


def is_posed_folder(folder: Path) -> bool:
    """Whether a folder has one of the layouts that can be read."""
    return (folder / TRAINING).is_file() or (folder / DATASET).is_file()


def read_posed_folder(folder: Path) -> PosedFolder:
    """Reads a folder of posed images, except for the pixels, and checks that all files are there.

    Raises:
        UserError: the layout is unknown, there is no training image, a file is missing or damaged, or values
            make no view.
    """
    points = bounds = None
    if (folder / TRAINING).is_file():
        layout, images = SYNTHETIC, read_synthetic(folder)
    elif (folder / DATASET).is_file():
        layout = NERFIES
        images, points, bounds = read_nerfies(folder)
    else:
        raise UserError(
            f"{folder}: unknown layout; must be that of {SYNTHETIC} ({TRAINING}) or of {NERFIES} ({DATASET})"
        )
    if all(image.held_out for image in images):
        raise UserError(f"{folder}: holds no frames to train on")
    return PosedFolder(folder, layout, _name(folder), _hash(images), images, points, bounds)


def _name(folder: Path) -> str:
    """The folder's name, as far as it can be that of a scene."""
    try:
        return claimed_scene(folder.resolve().name.lstrip(".") or _UNNAMED, "")[0]
    except ValueError:
        return _UNNAMED


def _hash(images: list[PosedImage]) -> str:
    """SHA-256 of all images, their labels, cameras and times."""
    state = hashlib.sha256()
    for image in images:
        state.update(repr((image.camera.key, image.lens, image.time, image.held_out)).encode())
        for file in (image.file, image.labels):
            if file is not None:
                try:
                    state.update(hashlib.sha256(file.read_bytes()).digest())
                except OSError as error:
                    raise UserError(f"{file}: cannot be read ({one_line(error)})") from error
    return state.hexdigest()
