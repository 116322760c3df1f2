"""Settings of a training as planned for the scene of its frames."""

from __future__ import annotations

from pathlib import Path

import pytest

from hybrid.preparation.forest_training import plan_with, planned_settings
from pathtrace.dataset.frame_set import FrameSet
from splat.training.trainer import TrainingSettings


def frames(**plan: object) -> FrameSet:
    names = {name.replace("_", " "): value for name, value in plan.items()}
    return FrameSet(Path("f"), "0", "any", "hash", [], "path", (), names)


def test_what_is_given_counts_then_what_is_planned_then_the_default():
    planned = frames(degree=0, gaussians=9000, path_depth=4)
    assert planned_settings(planned) == TrainingSettings(degree=0, gaussians=9000)
    assert planned_settings(planned, degree=3, seed=2, layers=None) == TrainingSettings(
        degree=3, gaussians=9000, seed=2
    )
    assert planned_settings(frames()) == planned_settings(None) == TrainingSettings()


def test_frames_are_halved_if_that_is_planned():
    assert planned_settings(frames(frame_precision="float16")).half_frames
    assert not planned_settings(frames(frame_precision="float32")).half_frames


def test_a_plan_says_what_the_training_made_of_it():
    found = plan_with(frames(degree=0, gaussians=9000, path_depth=4), TrainingSettings(degree=3, layers=2))
    assert found == {"degree": 3, "gaussians": 40_000, "layers": 2, "path depth": 4}
    assert plan_with(frames(), TrainingSettings()) == {}


def test_a_plan_that_is_none_is_refused():
    with pytest.raises(ValueError, match="many"):
        planned_settings(frames(gaussians="many"))
