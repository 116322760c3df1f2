"""Frames as views to train on: captured ones, with labels of what moves, and third-party ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from pathtrace.dataset.captured_frames import read_frame
from pathtrace.dataset.frame_set import FrameEntry, FrameSet, read_frame_set
from pathtrace.dataset.posed_images import PosedFolder, PosedImage, read_pixels
from pathtrace.dataset.posed_layouts import is_posed_folder, read_posed_folder
from pathtrace.scene.courses import Course
from splat.model.choices import Labels, MotionModel
from splat.training.depth_estimates import with_guesses
from splat.training.moving_pixels import Observation, moving_pixels, objects_of
from splat.training.trainer import TrainingSettings
from splat.training.training_view import TrainingView, in_half_precision, shows_sky

# What frames can be trained on.
Frames = FrameSet | PosedFolder


def read_frames(folder: Path) -> Frames:
    """A frame set, or a folder of posed images; UserError if a folder is neither, or damaged."""
    if is_posed_folder(folder):
        return read_posed_folder(folder)
    try:
        return read_frame_set(folder)
    except UserError:
        if (folder / "transforms.json").exists():
            raise
        raise UserError(
            f"{folder}: not a frame set (no transforms.json; hybrid capture makes one), nor third-party "
            "frames in a known layout (no transforms_train.json, dataset.json or sparse/0)"
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


def motion_for(frames: Frames, asked: MotionModel | None, labels: Labels | None = None) -> MotionModel:
    """The model of motion that was asked for, else what frames allow; UserError if they do not allow it."""
    if isinstance(frames, FrameSet):
        return asked or MotionModel.KNOWN
    learned = [model.value for model in MotionModel if model.field is not None]
    if asked is MotionModel.KNOWN and frames.moves:
        raise UserError(
            f"motion {asked.value}: {frames.folder} does not say how anything moves; learn it by one of "
            f"{', '.join(learned)}"
        )
    if labels is Labels.MASKS and any(image.labels is None for image in frames.training):
        raise UserError(f"labels {labels.value}: {frames.folder} has no label images that show what moves")
    # Of both fields, the one that is better and faster in as many steps.
    return asked or (MotionModel.HEX_PLANE if frames.moves else MotionModel.KNOWN)


def labelled_views(frames: Frames, settings: TrainingSettings) -> list[TrainingView]:
    """The training views of frames, whose pixels are labelled if a motion needs that.

    Labels are exact masks, or label images, if there are any, unless the settings ask for flow; and flow if
    there are none and the motion is one of labelled nodes only.
    """
    if isinstance(frames, FrameSet):
        each = (training_view(entry, frames.courses) for entry in frames.training)
        views = [in_half_precision(view) if settings.half_frames else view for view in each]
    else:
        # Their distances are guesses.
        posed = [posed_view(image) for image in frames.training]
        views = with_guesses(posed, frames.points, frames.bounds)
    wanted = settings.labels
    if wanted is None and settings.motion is MotionModel.D_GS_OF_DYNAMIC:
        wanted = Labels.MASKS if all(view.instance is not None for view in views) else Labels.FLOW
    if wanted is not Labels.FLOW:
        return views
    albedos: Sequence[NDArray[np.float32] | None] = [None] * len(views)
    if isinstance(frames, FrameSet):
        albedos = [read_frame(entry.file, entry.size).albedo for entry in frames.training]
    observations = [
        Observation(view.camera, view.radiance.astype(np.float32), view.distance, view.time, albedo)
        for view, albedo in zip(views, albedos, strict=True)
    ]
    objects = objects_of(observations, moving_pixels(observations))
    return [replace(view, instance=instance) for view, instance in zip(views, objects, strict=True)]


def training_view(entry: FrameEntry, courses: Sequence[Course] = ()) -> TrainingView:
    """A captured frame as a training view; `courses` are those of its frame set."""
    frame = read_frame(entry.file, entry.size)
    camera = entry.camera
    cosine = (camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]).reshape(frame.depth.shape)
    # The normal seen in a mirror is that of the mirror, not of the surface that appears behind it.
    # A mirror that shows nothing is black itself; the sky in it is as far away as that above it.
    empty = np.isinf(frame.unfolded) & ~shows_sky(frame.radiance, frame.unfolded)
    distance = np.where(empty, frame.depth / cosine, frame.unfolded).astype(np.float32)
    reflected = distance * cosine > frame.depth * 1.001
    normal = np.where(reflected[..., None], 0, frame.normal).astype(np.float32)
    instance = None
    if courses:
        instance = np.full(frame.shape.shape, -1, dtype=np.int32)
        for number, shape in enumerate(pieces_of(courses)):
            instance[frame.shape == shape] = number
    return TrainingView(camera, frame.radiance, distance, normal, time=entry.time, instance=instance)


def pieces_of(courses: Sequence[Course]) -> dict[int, int]:
    """Number of courses of each shape that has any, by its index, in their order."""
    return dict(Counter(course.shape for course in courses))
