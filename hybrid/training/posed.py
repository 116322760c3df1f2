"""Frames of others as training views: images with cameras and times, without a scene or distances."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compose.base.errors import UserError
from pathtrace.dataset.frames import FrameSet, read_frame_set
from pathtrace.posed.folder import PosedFolder, PosedImage
from pathtrace.posed.pixels import read_pixels
from pathtrace.posed.reading import is_posed_folder, read_posed_folder
from splat.model.motion_model import Labels, MotionModel
from splat.training.guesses import with_guesses
from splat.training.views import TrainingView

# What frames can be trained on.
Frames = FrameSet | PosedFolder


def read_frames(folder: Path) -> Frames:
    """A frame set, or a folder of posed images, whichever a folder is.

    Raises:
        UserError: it is neither, or damaged.
    """
    if is_posed_folder(folder):
        return read_posed_folder(folder)
    try:
        return read_frame_set(folder)
    except UserError:
        if (folder / "transforms.json").exists():
            raise
        raise UserError(
            f"{folder}: not a frame set (no transforms.json; hybrid capture makes one), nor frames of others "
            "in a known layout (no transforms_train.json, no dataset.json)"
        ) from None


def posed_view(image: PosedImage) -> TrainingView:
    """A posed image as a training view, with distances of inf where nothing is, and else of NaN: unknown."""
    pixels = read_pixels(image)
    distance = np.full(pixels.radiance.shape[:2], np.nan, dtype=np.float32)
    if pixels.alpha is not None:
        distance[pixels.alpha == 0] = np.inf
    instance = None if pixels.moving is None else np.where(pixels.moving, 0, -1).astype(np.int32)
    normal = np.zeros_like(pixels.radiance)
    return TrainingView(pixels.camera, pixels.radiance, distance, normal, time=image.time, instance=instance)


def posed_views(folder: PosedFolder) -> list[TrainingView]:
    """The training images of a folder as training views, with distances that are guesses."""
    views = [posed_view(image) for image in folder.training]
    return with_guesses(views, folder.points, folder.bounds)


def motion_for(frames: Frames, asked: MotionModel | None, labels: Labels | None = None) -> MotionModel:
    """The model of motion for frames: what was asked for, else what they allow.

    Raises:
        UserError: they cannot be trained with what was asked for.
    """
    if isinstance(frames, FrameSet):
        return asked or MotionModel.KNOWN
    learned = [model.value for model in MotionModel if model.field is not None]
    if asked is MotionModel.KNOWN and frames.moves:
        raise UserError(
            f"--motion {asked.value}: {frames.folder} does not say how anything moves; learn it by one of "
            f"{', '.join(learned)}"
        )
    if labels is Labels.MASKS and any(image.labels is None for image in frames.training):
        raise UserError(f"--labels {labels.value}: {frames.folder} has no label images that show what moves")
    # Of both fields, the one that is better and faster in as many steps (docs/measured/moving.md).
    return asked or (MotionModel.HEX_PLANE if frames.moves else MotionModel.KNOWN)
