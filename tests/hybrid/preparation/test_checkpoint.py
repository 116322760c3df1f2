"""Checkpoints of a training run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from compose.base.errors import UserError
from hybrid.preparation.forest_training import checkpoint_path, restore_checkpoint, save_checkpoint
from hybrid.preparation.training_views import training_view
from splat.io.tensors import load_tensors, save_tensors
from splat.training.trainer import Trainer
from tests.extremes import extreme


@pytest.fixture
def new(arrays, frames, training_settings):
    """Makes a trainer that has not begun."""
    views = [training_view(entry) for entry in frames.training]
    return lambda **changes: Trainer(arrays, views, replace(training_settings, **changes))


@pytest.fixture
def saved(new, frames, tmp_path) -> Path:
    """A checkpoint after two steps."""
    trainer = new(iterations=2)
    trainer.run(lambda done: None)
    save_checkpoint(trainer, tmp_path / "c", frames)
    return tmp_path / "c"


def test_a_checkpoint_lies_beside_its_forest():
    assert checkpoint_path(Path("a/room.forest")) == Path("a/room.forest.checkpoint")


def test_training_continues_from_a_checkpoint(new, frames, saved):
    trainer = new(iterations=2)
    restore_checkpoint(trainer, saved, frames)
    assert trainer.iteration == 2
    tensors, _ = load_tensors(saved)
    restored, _ = trainer.state()
    assert {*tensors} == {*restored}
    assert all(torch.equal(tensors[name], restored[name]) for name in tensors)


def test_without_a_checkpoint_training_begins(new, frames, tmp_path):
    trainer = new()
    restore_checkpoint(trainer, tmp_path / "c", frames)
    assert trainer.iteration == 0


def test_a_checkpoint_of_other_settings_is_refused(new, frames, saved):
    with pytest.raises(UserError, match=f"^{saved}: .*other settings; delete it to start again$"):
        restore_checkpoint(new(iterations=3), saved, frames)


def test_a_checkpoint_of_other_frames_is_refused(new, frames, saved):
    other = replace(frames, digest="ab" * 32)
    message = f"^{saved}: not a checkpoint of this training run; delete it to start again$"
    with pytest.raises(UserError, match=message):
        restore_checkpoint(new(iterations=2), saved, other)


def test_a_file_of_another_kind_is_refused(new, frames, tmp_path):
    for kind in ("forest", None):
        metadata = {"kind": kind, "frames": frames.digest} if kind else {"frames": frames.digest}
        save_tensors(tmp_path / "c", {"a": torch.zeros(1)}, metadata)
        with pytest.raises(UserError, match="not a checkpoint of this training run"):
            restore_checkpoint(new(), tmp_path / "c", frames)


@pytest.mark.parametrize("lost", ["tensor", "settings", "layers"])
def test_a_checkpoint_that_lacks_something_is_refused(new, frames, saved, lost):
    tensors, metadata = load_tensors(saved)
    if lost == "tensor":
        tensors.pop(next(iter(tensors)))
    else:
        metadata.pop(lost)
    save_tensors(saved, tensors, metadata)
    with pytest.raises(UserError, match=f"^{saved}: .*; delete it to start again$"):
        restore_checkpoint(new(iterations=2), saved, frames)


@extreme(
    "damaged checkpoints",
    given="cut off at 0, 1, 8, half and all but one byte, or a flipped bit in each of 20 places",
    expected="refused in one line that says to delete it",
)
def test_a_damaged_checkpoint_is_refused_with_advice(new, frames, saved, got):
    whole = saved.read_bytes()
    damaged = [whole[:length] for length in (0, 1, 8, len(whole) // 2, len(whole) - 1)]
    for at in range(100, len(whole), len(whole) // 20):
        content = bytearray(whole)
        content[at] ^= 1
        damaged.append(bytes(content))
    for content in damaged:
        saved.write_bytes(content)
        with pytest.raises(UserError, match=f"^{saved}: .*; delete it to start again$"):
            restore_checkpoint(new(iterations=2), saved, frames)
    got(f"{len(damaged)} of {len(damaged)} refused")
