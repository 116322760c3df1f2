"""What a preparation does next: stage after stage, until it is enough or the time is up."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hybrid.base.identity import Journal
from hybrid.preparation.forest_training import LEAST_PACED, Paced
from hybrid.preparation.stages import (
    FIRST_LOOK,
    LEAST_SPP,
    SIDE,
    STAGES,
    Needs,
    PreparationSettings,
    Stage,
    going_on,
    planned_among,
    planned_stage,
)

# What things take on two cores, in the scene `room`, in seconds: to trace and denoise a pixel, and each of
# its samples; to read a pixel and make a target of it; to build trees of a Gaussian, and in the end to learn
# where it is wrong; to place the first seeds.
_TRACED_PIXEL, _SAMPLE, _READ_PIXEL, BUILT, JUDGED, _SEEDED = 3.0e-6, 0.36e-6, 0.7e-6, 12e-6, 15e-6, 1.0
# A step without Gaussians, how many that the view shows take as long again, and how much longer larger frames
# take without Gaussians.
_STEP, _GAUSSIANS_OF_A_STEP, _OF_MORE_PIXELS = 0.013, 18_000, 2.0
# Share of all Gaussians that a view of the default region shows, and how it falls with the breadth of others.
_SHOWN, _SHOWN_LESS = 0.56, 0.65
# The least shares of its time that a stage is left and that it is begun with: others may take longer.
_LEFT_SHARE, _LEAST_SHARE = 0.5, 0.3
# Shares of its time that a stage may be stretched or shrunk to, the largest first.
_SHARES = np.geomspace(16.0, _LEAST_SHARE, 500).tolist()
# Shares of a scene's detail of which there may be time for two stages, the largest first.
_FEWER = np.geomspace(1.0, 0.5, 8).tolist()
# Least share of a stage's steps that are trained once its frames are there.
_LEAST_STEPS = 0.1
# What steps take over those of the first third of a training that goes on: there are more Gaussians, but in
# the end most steps are of coarser layers.
_LATER = 0.9
# Views of the first stage that tell how large it can be.
PROBED = 3


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
    # What a training takes besides its steps.
    besides = sum(one.views * one.side**2 for one in [*before, stage]) * _READ_PIXEL
    besides += stage.gaussians * BUILT if before else _SEEDED
    return Seconds(frames, besides + stage.steps * step_seconds(stage))


def _least_steps(stage: Stage) -> int:
    return max(-int(-stage.steps * _LEAST_STEPS // 1), min(stage.steps, LEAST_PACED))


def step_seconds(stage: Stage) -> float:
    """What a training step of a stage is expected to take."""
    of_pixels = _OF_MORE_PIXELS if stage.side > SIDE else 1
    shown = stage.gaussians * _SHOWN / stage.breadth**_SHOWN_LESS
    return _STEP * (of_pixels + shown / _GAUSSIANS_OF_A_STEP)


def next_stage(
    before: Sequence[Stage],
    needs: Needs,
    pace: Seconds,
    left: float | None,
    stages: Sequence[Stage] = STAGES,
) -> Stage | None:
    """The stage to do next, of those planned; None if there is no time for one.

    If there will be no time for another one, it is stretched over all of the time, or shrunk into it. Where
    there is too little time for it, the last stage goes on, with more samples and steps. `left` is in
    seconds; None if time does not matter.
    """
    stage = planned_stage(before, needs, stages)
    if left is None or _with_another(stage, before, needs, pace) <= left:
        return stage
    if before:
        goes_on = replace(before[-1], views=0)
        possible = [one.in_time(share) for one in (stage, goes_on) for share in _SHARES]
    else:
        possible = [_first_in_time(stage, share, pace) for share in _SHARES if share >= 1]
        possible += [replace(stage, spp=spp) for spp in range(stage.spp, LEAST_SPP - 1, -1)]
    fitting = next((one for one in possible if expected_seconds(one, before).at(pace) <= left), None)
    if fitting is not None or before:
        return fitting
    # What no view shows is missing, so that many small ones are better than few.
    least, look = _least_first(possible[-1], pace, left), FIRST_LOOK.for_needs(needs)
    return least if least.views >= look.views else look


def _with_another(stage: Stage, before: Sequence[Stage], needs: Needs, pace: Seconds) -> float:
    """Seconds of a stage after others, and of half of the one that follows it."""
    following = planned_stage([*before, stage], needs).in_time(_LEFT_SHARE)
    return expected_seconds(stage, before).at(pace) + expected_seconds(following, [*before, stage]).at(pace)


def affordable(needs: Needs, pace: Seconds, left: float, stages: Sequence[Stage] = STAGES) -> Needs:
    """What a scene takes, with as much of its detail as leaves time for two stages, at least half of it.

    All of it if there is time for one stage only. The second stage has frames of twice the resolution, which
    displays show: in a minute, `room` has 30.4 dB at 512 x 512 with all Gaussians and one stage, 32.5 dB with
    half of them and two.
    """
    fewer = [replace(needs, detail=needs.detail * share) for share in _FEWER]
    fits = (one for one in fewer if _with_another(planned_stage([], one, stages), [], one, pace) <= left)
    return next(fits, needs)


def _first_in_time(stage: Stage, share: float, pace: Seconds) -> Stage:
    """The first stage in a multiple of its time; where paths are dear, with fewer samples than others.

    Further samples are for as long as frames take no longer than the training: where they took two thirds of
    a minute, `classroom` had 2 dB less.
    """
    longer = stage.in_time(share)
    expected, least = expected_seconds(longer, []), expected_seconds(stage, []).frames * pace.frames
    most, training = expected.frames * pace.frames, expected.training * pace.training
    if most <= max(training, least):
        return longer
    further = max(0.0, training - least) / (most - least)
    return replace(longer, spp=stage.spp + int(further * (longer.spp - stage.spp)))


def _least_first(stage: Stage, pace: Seconds, left: float) -> Stage:
    """The first stage, with few samples, in less than its time: with fewer steps, and then fewer views.

    With 10 views `room` had 20 dB, with 20 views and as many steps 29.
    """
    expected, step = expected_seconds(stage, []), step_seconds(stage) * pace.training
    frames, besides = expected.frames * pace.frames, expected.training * pace.training - stage.steps * step
    steps = int(np.clip((left - frames - besides) / step, _least_steps(stage), stage.steps))
    share = (left - besides - steps * step) / frames
    return replace(stage, steps=steps, views=round(stage.views * min(share, 1.0)))


def _frames(views: int, stage: Stage, spp: int) -> float:
    """What it takes to trace further samples of views of a stage's size."""
    return views * stage.side**2 * (_TRACED_PIXEL + spp * _SAMPLE) if spp > 0 else 0.0


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


# Share of the time that is planned with: what a stage takes is known within a few percent.
_USED = 0.97
# Stages after which a target is given up, and the least gain in dB for which another stage is begun.
_MOST_STAGES, _LEAST_GAIN = 8, 0.15
# Before that, more views and pixels may bring more than the last stage did.
_LEAST_STAGES = 3
# What lacks of a target, in dB, that more samples and steps bring sooner than more views: for each decibel,
# twice the samples and as many steps again bring 1.0 to 1.2 (four scenes), half as many .4.
_NEARLY, _LEAST_LACKING = 2.0, 1.0


# In the journal, the pace that the first views have told, and what of the scene there is time for.
_PROBE, _NEEDS = "probe", "needs"
# Parts of a stage, in their order.
PARTS = "frame", "light", "training"


class Planner:
    """Decides what to do next; what it has decided once is in the journal, and stays."""

    def __init__(self, settings: PreparationSettings, journal: Journal, clock: JobClock, needs: Needs):
        self._settings, self.journal, self.clock = settings, journal, clock
        self._needs = Needs(**journal[_NEEDS]) if _NEEDS in journal else needs
        # Those begun, the views of those that another preparation has done, and how many are extra.
        self.stages: list[Stage] = []
        self.taken_over = self._extra = 0

    def begin(self, curve: list[dict[str, Any]]) -> bool:
        """Begins the next stage, unless the last one was enough by the curve of held-out quality so far."""
        number = len(self.stages)
        planned = self.journal.once(f"stage {number}", lambda: self._planned(number, curve))
        if planned:
            self.journal.once(f"began {number}", self.clock.seconds)
            self.stages.append(Stage(**planned))
        return bool(planned)

    def go_on(self, stages: Sequence[Stage], is_elsewhere: bool, is_changed: bool) -> None:
        """Goes on after stages of another preparation, first with what is new; see `going_on`."""
        self.stages, self.taken_over = list(stages), sum(stage.views for stage in stages)
        new = going_on(stages, is_elsewhere, is_changed)
        for number, stage in enumerate(new, len(stages)):
            self.journal.once(f"stage {number}", partial(asdict, stage))
        self._extra = len(stages) - planned_among(stages) + len(new)

    @property
    def planned(self) -> int:
        """Stages that are planned, if none is found to be enough."""
        return max(len(self.stages), len(self._settings.stages) + self._extra)

    @property
    def number(self) -> int:
        """Of the last stage, from 0."""
        return len(self.stages) - 1

    @property
    def is_to_fit(self) -> bool:
        """Whether it is not known yet how large the first stage, which has begun, can be."""
        return not self.number and self._settings.minutes is not None and _PROBE not in self.journal

    def fit_first(self, seconds: float) -> float:
        """Fits the first stage into the time, by the seconds that PROBED of its views took after one.

        Returns the share of the scene's detail for which there is time.
        """
        stage = self.stages[0]
        slower = seconds / _frames(PROBED, stage, stage.spp_at(stage.scale))
        # How much slower the machine is, training will be; the rest is the scene's paths.
        self.journal[_PROBE] = asdict(Seconds(slower, slower**0.5))
        left = self._left()
        assert left is not None
        left += (1 + 1 / PROBED) * seconds
        planned = self._needs
        self._needs = affordable(planned, self._pace(), left, self._settings.stages)
        self.journal[_NEEDS] = asdict(self._needs)
        fitting = next_stage([], self._needs, self._pace(), left, self._settings.stages)
        assert fitting is not None
        self.journal["stage 0"] = asdict(replace(fitting, views=max(1 + PROBED, fitting.views)))
        self.stages[0] = Stage(**self.journal["stage 0"])
        return self._needs.detail / planned.detail

    def steps(self) -> int:
        """Training steps of the last stage, as far as is known."""
        return self.journal.once(f"steps {self.number}", lambda: self.stages[-1].steps)

    @property
    def paced(self) -> Paced | None:
        """Says how many steps the last stage's training will have; None if time does not matter."""
        return None if self._settings.minutes is None else self._paced

    def _paced(self, seconds: float, done: int, fewest: int) -> int:
        number, stage, left = self.number, self.stages[-1], self._left()
        assert left is not None
        pace = replace(self._pace(), training=seconds / step_seconds(stage))
        if number:
            left -= pace.training * stage.gaussians * BUILT
            seconds *= _LATER
        possible = done + int(left / seconds)
        # No more than planned where the time that they leave is of use to further views.
        left -= seconds * max(0, stage.steps - done)
        following = next_stage(self.stages, self._needs, pace, left, self._settings.stages)
        if following is not None and following.views:
            possible = min(possible, stage.steps)
        self.journal[f"steps {number}"] = steps = max(possible, fewest, _least_steps(stage))
        return steps

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

    def _planned(self, number: int, curve: list[dict[str, Any]]) -> dict[str, Any] | None:
        psnr = [row["psnr"] for row in curve if "psnr" in row]
        if number and self._is_enough(psnr):
            return None
        if number and self._is_nearly_enough(psnr):
            return asdict(self._with_more_samples(psnr[-1]))
        # How long the first stage takes is not known before it has begun.
        left = self._left() if number else None
        if left is not None and f"light seconds {number - 1}" in self.journal:
            # What it depends on, Gaussians and times, grows little from stage to stage.
            left -= self.journal[f"light seconds {number - 1}"]
        pace = AS_EXPECTED if left is None else self._pace()
        stage = next_stage(self.stages, self._needs, pace, left, self._settings.stages)
        return asdict(stage) if stage else None

    def _is_enough(self, psnr: list[float]) -> bool:
        """Whether what was asked for is reached, or no more is to be had."""
        number = planned_among(self.stages)
        is_young = len(psnr) < _LEAST_STAGES or not self.stages[-1].views
        gained = is_young or psnr[-1] - psnr[-2] >= _LEAST_GAIN
        if self._settings.psnr is not None:
            return psnr[-1] >= self._settings.psnr or not gained or number >= _MOST_STAGES
        if self._settings.minutes is not None:
            # Until no further stage fits.
            return False
        return number >= len(self._settings.stages) or not gained

    def _is_nearly_enough(self, psnr: list[float]) -> bool:
        """Whether more samples of the views that there are may do, sooner than what is planned next."""
        wanted, views = self._settings.psnr, self.stages[-1].views
        return wanted is not None and views > 0 and wanted - psnr[-1] <= _NEARLY

    def _with_more_samples(self, psnr: float) -> Stage:
        """The last stage once more, without new views, for what lacks of the target."""
        assert self._settings.psnr is not None
        last, lacking = self.stages[-1], max(self._settings.psnr - psnr, _LEAST_LACKING)
        return replace(
            last, views=0, spp=round(last.spp * 2**lacking), steps=max(1, round(last.steps * lacking))
        )

    def _left(self) -> float | None:
        """Seconds left for stages; None if time does not matter."""
        if self._settings.minutes is None:
            return None
        judged = JUDGED * self.stages[-1].gaussians * self._pace().training
        return 60 * _USED * self._settings.minutes - judged - self.clock.seconds()

    def _pace(self) -> Seconds:
        """Seconds that finished stages took, over expected ones; before the first, as its views tell."""
        finished = [n for n in range(len(self.stages)) if f"training seconds {n}" in self.journal]
        if not finished:
            return Seconds(**self.journal[_PROBE]) if _PROBE in self.journal else AS_EXPECTED
        done = [
            (replace(self.stages[n], steps=self.journal[f"steps {n}"]), self.stages[:n]) for n in finished
        ]
        expected = (astuple(expected_seconds(*one)) for one in done)
        of_frames, of_training = (sum(part) for part in zip(*expected, strict=True))
        frames, training = (
            sum(self.journal[f"{part} seconds {n}"] for n in finished) for part in ("frame", "training")
        )
        return Seconds(frames / of_frames, training / of_training)
