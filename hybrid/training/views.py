"""Captured frames as views to train on, with labels of what moves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid.training.posed import Frames, posed_views
from pathtrace.dataset.exr import read_frame
from pathtrace.dataset.frames import FrameEntry, FrameSet
from pathtrace.motion.course import Course
from splat.model.motion_model import Labels, MotionModel
from splat.separation.evidence import moving_pixels
from splat.separation.objects import objects_of
from splat.separation.observation import Observation
from splat.training.sky import shows_sky
from splat.training.trainer import TrainingSettings
from splat.training.views import TrainingView, in_half_precision


def labelled_views(frames: Frames, settings: TrainingSettings) -> list[TrainingView]:
    """The training views of frames, whose pixels are labelled if a motion needs that.

    Labels are exact masks, or label images, if there are any, unless the settings ask for flow; and flow if
    there are none and the motion is one of labelled nodes only.
    """
    if isinstance(frames, FrameSet):
        each = (training_view(entry, frames.courses) for entry in frames.training)
        views = [in_half_precision(view) if settings.half_frames else view for view in each]
    else:
        views = posed_views(frames)
    wanted = settings.labels
    if wanted is None and settings.motion is MotionModel.D_GS_OF_DYNAMIC:
        wanted = Labels.MASKS if all(view.instance is not None for view in views) else Labels.FLOW
    return _with_flow(frames, views) if wanted is Labels.FLOW else views


def _with_flow(frames: Frames, views: list[TrainingView]) -> list[TrainingView]:
    """Views whose pixels are labelled by what frames of other times show."""
    observations = [
        Observation(view.camera, view.radiance.astype(np.float32), view.distance, view.time, albedo)
        for view, albedo in zip(views, _albedos(frames), strict=True)
    ]
    objects = objects_of(observations, moving_pixels(observations))
    return [replace(view, instance=instance) for view, instance in zip(views, objects, strict=True)]


def _albedos(frames: Frames) -> list[NDArray[np.float32] | None]:
    """(H, W, 3) of each training frame; None where nobody knows it."""
    if not isinstance(frames, FrameSet):
        return [None] * len(frames.training)
    return [read_frame(entry.file, entry.size).albedo for entry in frames.training]


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
