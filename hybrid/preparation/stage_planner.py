"""What a preparation does next: stage after stage, until it is enough or the time is up."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass, replace
from typing import Any

from hybrid.base.journal import Journal
from hybrid.preparation.stages import QUALITIES, SIDE, Needs, PreparationSettings, Stage, planned_stage

# What things take on two cores of an AMD EPYC, in the scene `room`, in seconds: to trace and denoise a pixel,
# and each of its samples; to read a pixel and make a target of it; to build trees of a Gaussian; to place the
# first seeds.
_TRACED_PIXEL, _SAMPLE, _READ_PIXEL, _BUILT, _SEEDED = 2.25e-6, 0.27e-6, 0.7e-6, 60e-6, 1.0
# A step without Gaussians, how many that the view shows take as long again, and how much longer larger frames
# take without Gaussians.
_STEP, _GAUSSIANS_OF_A_STEP, _OF_MORE_PIXELS = 0.013, 18_000, 2.0
# Share of all Gaussians that a view of the default region shows, and how it falls with the breadth of others.
_SHOWN, _SHOWN_LESS = 0.56, 0.65
# A stage that would get a smaller share of its time is not begun; instead, the last one goes on with views
# and steps in this proportion, and at least so many steps: with 75, `room` lost 1.8 dB, since harmonics begin
# anew and steps are large at first.
_LEAST_SHARE, _REST_VIEWS, _REST_STEPS, _LEAST_REST = 0.3, 16, 200, 150
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
    """Steps of a stage, whose frames are there, that fit in a time at some pace; at least a tenth of them."""
    steps = int((seconds / pace.training - _prepared(stage, before)) / step_seconds(stage))
    return max(min(stage.steps, steps), -int(-stage.steps * _LEAST_STEPS // 1))


def step_seconds(stage: Stage) -> float:
    """What a training step of a stage is expected to take."""
    of_pixels = _OF_MORE_PIXELS if stage.side > SIDE else 1
    shown = stage.gaussians * _SHOWN / stage.breadth**_SHOWN_LESS
    return _STEP * (of_pixels + shown / _GAUSSIANS_OF_A_STEP)


def next_stage(before: Sequence[Stage], needs: Needs, pace: Seconds, left: float | None) -> Stage | None:
    """The stage to do next; None if there is no time for one.

    It is stretched over the time that would be left without use. Where it has too little time, the last one
    goes on. `left` is in seconds; None if time does not matter.
    """
    number = sum(not one.is_rest for one in before)
    stage = planned_stage(number, needs)
    if left is None or not before:
        return stage
    share = _share(stage, before, pace, left)
    if share < _LEAST_SHARE:
        return _rest(before, pace, left)
    following = planned_stage(number + 1, needs)
    left_then = left - expected_seconds(stage, before).at(pace)
    another_fits = _share(following, [*before, stage], pace, left_then) >= _LEAST_SHARE
    return stage if another_fits else stage.in_time(share)


def _rest(before: Sequence[Stage], pace: Seconds, left: float) -> Stage | None:
    """More views and steps of the last stage's kind, where nothing else fits; None if they are too few."""
    stage = replace(before[-1], views=_REST_VIEWS, steps=_REST_STEPS, is_rest=True)
    stage = stage.in_time(max(0.0, _share(stage, before, pace, left)))
    return stage if stage.steps >= _LEAST_REST else None


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
    return pixels * _READ_PIXEL + (stage.gaussians * _BUILT if before else _SEEDED)


_KEY = "seconds"


class JobClock:
    """Counts the seconds of a job, including earlier runs; this one began at time.perf_counter() `start`."""

    def __init__(self, journal: Journal, start: float):
        self._journal, self._since = journal, start
        self._spent: float = journal.once(_KEY, lambda: 0.0)

    def seconds(self) -> float:
        """Seconds that count so far."""
        return self._spent + time.perf_counter() - self._since

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Within it, no time counts."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._since += time.perf_counter() - start

    def keep(self) -> None:
        """Writes the seconds down, for the next run."""
        self._journal[_KEY] = self.seconds()


# Seconds that fitting the fusion takes where stages take as long as expected; it is left out of a job that
# has less than twice as many, and has at most a share of any job.
_FUSION_SECONDS, _FUSION_SHARE = 50.0, 1 / 3
# Share of the time that is planned with: what a stage takes is known within a few percent.
_USED = 0.97
# Stages after which a target is given up, and the least gain in dB for which another stage is begun.
_MOST_STAGES, _LEAST_GAIN = 8, 0.15
# Before that, more views and pixels may bring more than the last stage did.
_LEAST_STAGES = 3


# Parts of a stage, in their order.
PARTS = "frame", "light", "training"


class Planner:
    """Decides what to do next; what it has decided once is in the journal, and stays."""

    def __init__(self, settings: PreparationSettings, journal: Journal, clock: JobClock, needs: Needs):
        self._settings, self.journal, self.clock, self._needs = settings, journal, clock, needs
        # Those begun.
        self.stages: list[Stage] = []

    def begin(self, curve: list[dict[str, Any]]) -> bool:
        """Begins the next stage, unless the last one was enough by the curve of held-out quality so far."""
        number = len(self.stages)
        planned = self.journal.once(f"stage {number}", lambda: self._planned(number, curve))
        if planned:
            self.journal.once(f"began {number}", self.clock.seconds)
            self.stages.append(Stage(**planned))
        return bool(planned)

    @property
    def number(self) -> int:
        """Of the last stage, from 0."""
        return len(self.stages) - 1

    def steps(self) -> int:
        """Training steps of the last stage, for which its frames have left the time."""
        return self.journal.once(f"steps {self.number}", self._affordable)

    def lap(self, part: str) -> float:
        """Notes that the last stage has done one of PARTS; returns the seconds that it took, in all runs."""
        number = self.number
        before = sum(self.journal[f"{one} seconds {number}"] for one in PARTS[: PARTS.index(part)])
        taken = lambda: self.clock.seconds() - self.journal[f"began {number}"] - before  # noqa: E731
        return self.journal.once(f"{part} seconds {number}", taken)

    @property
    def is_finished(self) -> bool:
        """Whether the last stage was finished, perhaps in an earlier run."""
        return f"training seconds {self.number}" in self.journal

    @property
    def fits_fusion(self) -> bool:
        """Whether there is time for a fusion."""
        minutes = self._settings.minutes
        return minutes is None or 60 * minutes > 2 * _FUSION_SECONDS

    @property
    def fusion_share(self) -> float:
        """Share of the samples for which the fusion has time, up to 1."""
        minutes, wanted = self._settings.minutes, _FUSION_SECONDS * self._pace().frames
        return 1.0 if minutes is None else min(1.0, 60 * minutes * _FUSION_SHARE / wanted)

    def _planned(self, number: int, curve: list[dict[str, Any]]) -> dict[str, Any] | None:
        if number and self._is_enough(number, [row["psnr"] for row in curve if "psnr" in row]):
            return None
        left = self._left()
        if left is not None and f"light seconds {number - 1}" in self.journal:
            # What it depends on, Gaussians and times, grows little from stage to stage.
            left -= self.journal[f"light seconds {number - 1}"]
        stage = next_stage(self.stages, self._needs, self._pace(), left)
        return asdict(stage) if stage else None

    def _is_enough(self, number: int, psnr: list[float]) -> bool:
        """Whether what was asked for is reached, or no more is to be had."""
        gained = len(psnr) < _LEAST_STAGES or psnr[-1] - psnr[-2] >= _LEAST_GAIN
        if self._settings.psnr is not None:
            return psnr[-1] >= self._settings.psnr or not gained or number >= _MOST_STAGES
        if self._settings.minutes is not None:
            return number >= _MOST_STAGES
        return number >= QUALITIES[self._settings.quality] or not gained

    def _affordable(self) -> int:
        stage, before, left = self.stages[-1], self.stages[:-1], self._left()
        if left is None or not before:
            return stage.steps
        return affordable_steps(stage, before, left, self._pace())

    def _left(self) -> float | None:
        """Seconds left for stages; None if time does not matter."""
        if self._settings.minutes is None:
            return None
        fusion = _FUSION_SECONDS * self._pace().frames * self.fusion_share if self.fits_fusion else 0.0
        return 60 * _USED * self._settings.minutes - self.clock.seconds() - fusion

    def _pace(self) -> Seconds:
        """Seconds that finished stages took, over the expected ones; as expected before the first."""
        finished = [n for n in range(len(self.stages)) if f"training seconds {n}" in self.journal]
        if not finished:
            return AS_EXPECTED
        done = [
            (replace(self.stages[n], steps=self.journal[f"steps {n}"]), self.stages[:n]) for n in finished
        ]
        expected = (astuple(expected_seconds(*one)) for one in done)
        of_frames, of_training = (sum(part) for part in zip(*expected, strict=True))
        frames, training = (
            sum(self.journal[f"{part} seconds {n}"] for n in finished) for part in ("frame", "training")
        )
        return Seconds(frames / of_frames, training / of_training)
