"""How long stages are expected to take, and which one fits in the time that is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid.plan.needs import Needs
from hybrid.preparation.stages import SIDE, Stage, planned_stage

# What things take on two cores of an AMD EPYC, in the scene `room`, in seconds: to trace and denoise a pixel,
# and each of its samples; to read a pixel and make a target of it; to build trees of a Gaussian.
_TRACED_PIXEL, _SAMPLE, _READ_PIXEL, _BUILT = 2.25e-6, 0.27e-6, 0.7e-6, 60e-6
# A step without Gaussians, how many that the view shows take as long again, and how much longer larger frames
# take without Gaussians.
_STEP, _GAUSSIANS_OF_A_STEP, _OF_MORE_PIXELS = 0.013, 18_000, 2.0
# Share of all Gaussians that a view of the default region shows, and how it falls with the breadth of others.
_SHOWN, _SHOWN_LESS = 0.56, 0.65
# A stage that would get a smaller share of its time is not begun.
_LEAST_SHARE = 0.3
# Least share of a stage's steps that are trained once its frames are there.
_LEAST_STEPS = 0.1


@dataclass(frozen=True)
class Seconds:
    """Seconds that the two parts of a stage take; or their pace, seconds over those that were expected."""

    frames: float
    training: float

    def at(self, pace: Seconds) -> float:
        """Seconds in all at some pace."""
        return self.frames * pace.frames + self.training * pace.training


AS_EXPECTED = Seconds(1.0, 1.0)


def expected_seconds(stage: Stage, before: Sequence[Stage]) -> Seconds:
    """What a stage takes after others, on the machine and in the scenes that this was measured on."""
    frames = _frames(stage.views, stage, stage.spp_at(stage.scale))
    for number, earlier in enumerate(before):
        had = max(one.spp_at(earlier.scale) for one in before[number:])
        frames += _frames(earlier.views, earlier, stage.spp_at(earlier.scale) - had)
    return Seconds(frames, _prepared(stage, before) + stage.steps * step_seconds(stage))


def affordable_steps(stage: Stage, before: Sequence[Stage], seconds: float, pace: Seconds) -> int:
    """Steps that fit in a time, at most those of the stage; at least a tenth of them.

    Args:
        stage: whose frames are there.
        before: the stages before.
        seconds: the time.
        pace: of the stages before.
    """
    steps = int((seconds / pace.training - _prepared(stage, before)) / step_seconds(stage))
    return max(min(stage.steps, steps), -int(-stage.steps * _LEAST_STEPS // 1))


def step_seconds(stage: Stage) -> float:
    """What a training step of a stage is expected to take."""
    of_pixels = _OF_MORE_PIXELS if stage.side > SIDE else 1
    shown = stage.gaussians * _SHOWN / stage.breadth**_SHOWN_LESS
    return _STEP * (of_pixels + shown / _GAUSSIANS_OF_A_STEP)


def next_stage(before: Sequence[Stage], needs: Needs, pace: Seconds, left: float | None) -> Stage | None:
    """The stage to do next; None if there is no time for one.

    It is stretched over the time that would be left without use: a stage that has too little time is worse
    than none, since each begins with large steps again.

    Args:
        before: the stages done.
        needs: of the region and the scene.
        pace: of the stages done.
        left: seconds; None if they do not matter.
    """
    stage = planned_stage(len(before), needs)
    if left is None or not before:
        return stage
    share = _share(stage, before, pace, left)
    if share < _LEAST_SHARE:
        return None
    following = planned_stage(len(before) + 1, needs)
    left_then = left - expected_seconds(stage, before).at(pace)
    another_fits = _share(following, [*before, stage], pace, left_then) >= _LEAST_SHARE
    return stage if another_fits else stage.in_time(share)


def _share(stage: Stage, before: Sequence[Stage], pace: Seconds, left: float) -> float:
    """Share of a stage's new views and steps, or multiple of them, that fits in a time."""
    least = expected_seconds(stage.in_time(0), before).at(pace)
    return (left - least) / (expected_seconds(stage, before).at(pace) - least)


def _frames(views: int, stage: Stage, spp: int) -> float:
    """What it takes to trace further samples of views of a stage's size."""
    return views * stage.side**2 * (_TRACED_PIXEL + spp * _SAMPLE) if spp > 0 else 0.0


def _prepared(stage: Stage, before: Sequence[Stage]) -> float:
    """What a training takes besides its steps."""
    pixels = sum(one.views * one.side**2 for one in [*before, stage])
    return pixels * _READ_PIXEL + (stage.gaussians * _BUILT if before else 0.0)
