"""Checkpoints of an unfinished training run, from which it resumes."""

from __future__ import annotations

from pathlib import Path

from compose.base.errors import UserError, one_line
from hybrid.training.posed import Frames
from splat.io.tensors import FORMAT_VERSION, load_tensors, save_tensors
from splat.training.trainer import Trainer


def checkpoint_path(forest: Path) -> Path:
    """File of the checkpoint of a forest that is being trained."""
    return forest.with_name(forest.name + ".checkpoint")


def save_checkpoint(trainer: Trainer, path: Path, frames: Frames) -> None:
    """Saves the state of a training run on a frame set.

    Raises:
        UserError: the file cannot be written.
    """
    tensors, numbers = trainer.state()
    kind = {"format_version": FORMAT_VERSION, "kind": "checkpoint", "frames": frames.digest}
    save_tensors(path, tensors, {**kind, **numbers})


def restore_checkpoint(trainer: Trainer, path: Path, frames: Frames) -> None:
    """Continues from a checkpoint if there is one.

    Raises:
        UserError: the checkpoint is damaged, or belongs to another training run.
    """
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
