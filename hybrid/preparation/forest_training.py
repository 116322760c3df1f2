"""Trains a forest on frames, as planned for their scene; resumes if interrupted."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from compose.base.errors import UserError, one_line
from hybrid.base.compute_device import device_arrays
from hybrid.base.progress import Steps, interrupts_between_steps, no_progress
from hybrid.preparation.decisions import DEGREE, FRAME_PRECISION, GAUSSIANS, HALF, LAYERS, Value
from hybrid.preparation.forest_errors import with_errors
from hybrid.preparation.training_views import Frames, labelled_views, motion_for, pieces_of
from hybrid.render.forest_attachments import attach_plan, attach_views
from pathtrace.dataset.frame_set import FrameSet
from pathtrace.scene.courses import Course
from splat.io.compact import compact
from splat.io.forest_file import save_forest
from splat.io.tensors import FORMAT_VERSION, load_tensors, save_tensors
from splat.model.choices import MotionModel, Precision
from splat.model.dynamic_light import SurfaceLight
from splat.model.forest import Forest, forest_of
from splat.model.motion import NodeMotion
from splat.model.trees import check_forest
from splat.training.trainer import ALONE, Trainer, TrainingSettings, most_layers
from splat.training.training_view import finest_focal

_LOG = logging.getLogger("hybrid")
_PLANNED = {"gaussians": GAUSSIANS, "layers": LAYERS, "degree": DEGREE}


def planned_settings(frames: Frames | None, **given: object) -> TrainingSettings:
    """Settings of a training: as given, else as planned for the scene of the frames, else their defaults.

    None and third-party frames have no plan; a setting that is None counts as not given. Errors are those of
    TrainingSettings.
    """
    plan = _plan(frames)
    wanted: dict[str, Any] = {field: int(plan[name]) for field, name in _PLANNED.items() if name in plan}
    wanted["half_frames"] = plan.get(FRAME_PRECISION) == HALF
    return TrainingSettings(**wanted | {name: value for name, value in given.items() if value is not None})


def plan_with(frames: Frames, settings: TrainingSettings) -> dict[str, Value]:
    """The plan for the scene of the frames, with what a training made of it; empty if there is none."""
    plan = _plan(frames)
    return plan and plan | {name: getattr(settings, field) for field, name in _PLANNED.items()}


def _plan(frames: Frames | None) -> dict[str, Any]:
    return dict(frames.plan) if isinstance(frames, FrameSet) else {}


def checkpoint_path(forest: Path) -> Path:
    """File of the checkpoint of a forest that is being trained."""
    return forest.with_name(forest.name + ".checkpoint")


def save_checkpoint(trainer: Trainer, path: Path, frames: Frames) -> None:
    """Saves the state of a training run on a frame set; UserError if the file cannot be written."""
    tensors, numbers = trainer.state()
    kind = {"format_version": FORMAT_VERSION, "kind": "checkpoint", "frames": frames.digest}
    save_tensors(path, tensors, {**kind, **numbers})


def restore_checkpoint(trainer: Trainer, path: Path, frames: Frames) -> None:
    """Continues from a checkpoint if there is one; UserError if it is damaged, or of another training."""
    if not path.is_file():
        return
    tensors, metadata = load_tensors(path, "delete it to start again")
    if metadata.get("kind") != "checkpoint" or metadata.get("frames") != frames.digest:
        raise UserError(f"{path}: not a checkpoint of this training run; delete it to start again")
    try:
        trainer.restore(tensors, metadata)
        if not 0 <= trainer.iteration <= trainer.settings.iterations:
            raise ValueError(f"the checkpoint is of step {trainer.iteration}")
    except (ValueError, LookupError, TypeError, AttributeError, RuntimeError, OverflowError) as error:
        raise UserError(f"{path}: {one_line(error)}; delete it to start again") from error


_CHECKPOINT_SECONDS = 30.0
# Trainings of fewer steps have as many as they are asked for.
LEAST_PACED = 40


class Paced(Protocol):
    """Decides how many steps a training has, while it tells how long they take."""

    def __call__(self, seconds: float, done: int, fewest: int) -> int:
        """Steps in all, at least the fewest, if each takes so many seconds now and so many are done."""
        ...


@dataclass(frozen=True)
class LeftOut:
    """How many frames and optimizer steps a training did not learn from, because they were not finite."""

    frames: int
    steps: int


def say_left_out(left_out: LeftOut) -> None:
    """Says in one line what a training did not learn from; nothing if it learnt from all."""
    if left_out.frames or left_out.steps:
        _LOG.warning(
            f"Left out of the training: {left_out.frames} frames with numbers that are not finite, and "
            f"{left_out.steps} steps whose gradient was not."
        )


def motion_of(courses: Sequence[Course]) -> NodeMotion | None:
    """The motion of the instances that have courses; None if nothing moves."""
    if not courses:
        return None
    rotations = np.stack([course.rotations for course in courses], axis=1)
    shifts = np.stack([course.shifts for course in courses], axis=1)
    centres = np.stack([course.centre for course in courses])
    pieces = np.array(list(pieces_of(courses).values()), dtype=np.int64)
    return NodeMotion(*(torch.from_numpy(part) for part in (rotations, centres, shifts, pieces)))


def train(  # noqa: PLR0913 (a training's parts, each with one user)
    frames: Frames,
    path: Path,
    settings: TrainingSettings | None = None,
    progress: Steps = no_progress,
    report: Callable[[LeftOut], None] = say_left_out,
    start: Forest | None = None,
    light: SurfaceLight | None = None,
    precision: Precision = Precision.COMPACT,
    paced: Paced | None = None,
    learns_errors: bool = True,
) -> Forest:
    """Trains a forest and writes it to a file; resumes if interrupted.

    Args:
        frames: captured or third-party ones.
        path: forest file to write; a checkpoint is kept beside it until training is complete.
        settings: as planned for the frames' scene if None.
        progress: called with steps done and steps in total.
        report: called in the end with what was not finite and therefore left out.
        start: whose finest layer to go on from.
        light: on the surfaces that the frames show, in their coordinates; None if it is not known to change.
        precision: of the numbers in the file, which are those of the forest that is returned.
        paced: says how many steps it will be, LEAST_PACED or more; as in the settings if None, and in
            trainings of fewer.
        learns_errors: whether the forest learns where it is wrong; see `with_errors`.

    UserError if there are no frames to train on, a motion is to be learned from frames of a single time, a
    frame is damaged, no frame is finite, none shows a surface, frames are too small for the layers, or the
    file cannot be written.
    """
    settings = settings or planned_settings(frames, motion=motion_for(frames, None))
    _require_enough(frames, settings)
    views = labelled_views(frames, settings)
    cameras, focal = [view.camera for view in views], finest_focal(views)
    courses = frames.courses if isinstance(frames, FrameSet) else ()
    try:
        known = motion_of(courses) if settings.motion is MotionModel.KNOWN else None
        trainer = Trainer(device_arrays(), views, settings, start, known, light)
    except ValueError as error:
        raise UserError(f"{frames.folder}: {error}") from error
    # The trainer has its own, in its coordinates.
    del views
    checkpoint = checkpoint_path(path)
    restore_checkpoint(trainer, checkpoint, frames)
    _run(trainer, checkpoint, frames, progress, paced)
    settings = trainer.settings
    scene = frames.scene_name, frames.scene_hash
    forest = forest_of(trainer.forest(), focal, *scene, trainer.place, trainer.motion, trainer.light)
    if not forest.nodes.gaussians.is_finite():
        raise RuntimeError("training ended with numbers that are not finite")
    check_forest(forest.layers)
    if precision is Precision.COMPACT:
        # Before the errors, which are those of what will be drawn.
        forest = compact(forest)
    if learns_errors:
        forest = with_errors(frames, forest)
    forest = attach_plan(attach_views(forest, cameras), plan_with(frames, settings))
    save_forest(path, forest)
    report(LeftOut(trainer.dropped, trainer.skipped))
    checkpoint.unlink(missing_ok=True)
    return forest


def _require_enough(frames: Frames, settings: TrainingSettings) -> None:
    if not frames.training:
        raise UserError(f"{frames.folder}: holds no frames to train on")
    motion_for(frames, settings.motion, settings.labels)
    if settings.motion.field is not None and len({entry.time for entry in frames.training}) == 1:
        raise UserError(
            f"{frames.folder}: all frames show the same time; a motion ({settings.motion.value}) can only be "
            "learned from frames of several times"
        )
    camera = max((entry.camera for entry in frames.training), key=lambda camera: camera.fy)
    most = most_layers(camera.width, camera.height)
    if most < settings.layers:
        raise UserError(
            f"{frames.folder}: frames of {camera.width} x {camera.height} pixels are too small for "
            f"{settings.layers} layers; they allow {most}, or capture larger ones"
        )


# Steps of which the first ones are slow, and after which it is told for the first time how long one takes;
# then whenever there are twice as many, and at last before trees are built.
_SLOW, _FIRST_TOLD = 3, 8


def _run(trainer: Trainer, checkpoint: Path, frames: Frames, progress: Steps, paced: Paced | None) -> None:
    """Trains to the end; saves a checkpoint regularly and on Ctrl-C."""
    saved = time.perf_counter()

    def step(done: int) -> None:
        nonlocal saved
        progress(done, trainer.settings.iterations)
        if time.perf_counter() - saved > _CHECKPOINT_SECONDS:
            save_checkpoint(trainer, checkpoint, frames)
            saved = time.perf_counter()
        interrupted()

    with interrupts_between_steps() as interrupted:
        try:
            if paced is not None and trainer.settings.iterations >= LEAST_PACED:
                _pace(trainer, checkpoint, step, paced)
                save_checkpoint(trainer, checkpoint, frames)
            trainer.run(step)
        except KeyboardInterrupt:
            save_checkpoint(trainer, checkpoint, frames)
            raise


def _pace(trainer: Trainer, checkpoint: Path, step: Callable[[int], None], paced: Paced) -> None:
    """Trains as long as steps tell how many there can be."""
    told, slow = 0, _SLOW
    while (until := max(_FIRST_TOLD, min(2 * told, int(ALONE * trainer.settings.iterations)))) > told:
        # Unless this run began later.
        if trainer.iteration + slow < until:
            trainer.run(step, trainer.iteration + slow)
            start, before, slow = time.perf_counter(), trainer.iteration, 0
            trainer.run(step, until)
            seconds = (time.perf_counter() - start) / (until - before)
            # It is of another number of steps from now on.
            checkpoint.unlink(missing_ok=True)
            trainer.last(paced(seconds, until, trainer.fewest))
        told = until
