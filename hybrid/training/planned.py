"""Settings of a training as planned for the scene of its frames."""

from __future__ import annotations

from typing import Any

from hybrid.plan.appearance import DEGREE, FRAME_PRECISION, HALF
from hybrid.plan.decision import Value
from hybrid.plan.detail import GAUSSIANS
from hybrid.plan.layers import LAYERS
from hybrid.training.posed import Frames
from pathtrace.dataset.frames import FrameSet
from splat.training.trainer import TrainingSettings

_PLANNED = {"gaussians": GAUSSIANS, "layers": LAYERS, "degree": DEGREE}


def planned_settings(frames: Frames | None, **given: Any) -> TrainingSettings:
    """Settings of a training: as given, else as planned for the scene of the frames, else their defaults.

    Args:
        frames: to train on; those of others have no plan, and None has none.
        given: fields of TrainingSettings; None counts as not given.

    Raises:
        UserError, ValueError: as of TrainingSettings.
    """
    plan = _plan(frames)
    planned = {field: int(plan[name]) for field, name in _PLANNED.items() if name in plan}
    planned["half_frames"] = plan.get(FRAME_PRECISION) == HALF
    return TrainingSettings(**planned | {name: value for name, value in given.items() if value is not None})


def plan_with(frames: Frames, settings: TrainingSettings) -> dict[str, Value]:
    """The plan for the scene of the frames, with what a training made of it; empty if there is none."""
    plan = _plan(frames)
    return plan and plan | {name: getattr(settings, field) for field, name in _PLANNED.items()}


def _plan(frames: Frames | None) -> dict[str, Any]:
    return dict(frames.plan) if isinstance(frames, FrameSet) else {}
