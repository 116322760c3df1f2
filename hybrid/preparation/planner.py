"""Plans a preparation: stage after stage, until what was asked for is reached or the time is up."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from hybrid.plan.needs import Needs
from hybrid.preparation.clock import Clock
from hybrid.preparation.settings import PreparationSettings
from hybrid.preparation.stages import QUALITIES, Stage
from hybrid.preparation.timing import AS_EXPECTED, Seconds, affordable_steps, expected_seconds, next_stage
from hybrid.store.journal import Journal

# Seconds that fitting the fusion takes where stages take as long as expected; left out of a shorter job.
_FUSION_SECONDS = 50.0
# Share of the time that is planned with: what a stage takes is known within a few percent.
_USED = 0.97
# Stages after which a target is given up, and the least gain in dB for which another stage is begun.
_MOST_STAGES, _LEAST_GAIN = 8, 0.15
# Before that, more views and pixels may bring more than the last stage did.
_LEAST_STAGES = 3


class Planner:
    """Decides what to do next; what it has decided once is in the journal, and stays.

    Args:
        settings: what was asked for.
        journal: of the job.
        clock: of the job.
        needs: of the region and the scene.

    Attributes:
        stages: those begun.
    """

    def __init__(self, settings: PreparationSettings, journal: Journal, clock: Clock, needs: Needs):
        self._settings, self._journal, self._clock, self._needs = settings, journal, clock, needs
        self.stages: list[Stage] = []

    def begin(self, curve: list[dict[str, Any]]) -> bool:
        """Begins the next stage, unless the last one was enough.

        Args:
            curve: held-out quality after each stage so far: rows with `psnr`, if there are held-out views.
        """
        number = len(self.stages)
        planned = self._journal.once(f"stage {number}", lambda: self._planned(number, curve))
        if planned:
            self._journal.once(f"began {number}", self._clock.seconds)
            self.stages.append(Stage(**planned))
        return bool(planned)

    def steps(self) -> int:
        """Training steps of the last stage, for which its frames have left the time."""
        return self._journal.once(f"steps {len(self.stages) - 1}", self._affordable)

    def framed(self) -> float:
        """Takes down that the last stage has its frames; returns the seconds that they took."""
        number = len(self.stages) - 1
        return self._journal.once(f"frame seconds {number}", lambda: self._since_begin(number))

    def lit(self) -> float:
        """Takes down that its light is known, too; returns the seconds that it took."""
        number = len(self.stages) - 1
        return self._journal.once(
            f"light seconds {number}", lambda: self._since_begin(number) - self.framed()
        )

    def trained(self) -> None:
        """Takes down that the last stage is finished."""
        number = len(self.stages) - 1
        seconds = self._since_begin(number) - self.framed() - self.lit()
        self._journal[f"training seconds {number}"] = seconds

    def _since_begin(self, number: int) -> float:
        """Seconds since a stage began, in all runs of the job."""
        return self._clock.seconds() - self._journal[f"began {number}"]

    @property
    def is_finished(self) -> bool:
        """Whether the last stage was finished, perhaps in an earlier run."""
        return f"training seconds {len(self.stages) - 1}" in self._journal

    @property
    def fits_fusion(self) -> bool:
        """Whether there is time for a fusion."""
        minutes = self._settings.minutes
        return minutes is None or 60 * minutes > 2 * _FUSION_SECONDS

    def _planned(self, number: int, curve: list[dict[str, Any]]) -> dict[str, Any] | None:
        if number and self._is_enough(number, [row["psnr"] for row in curve if "psnr" in row]):
            return None
        left = self._left()
        if left is not None and f"light seconds {number - 1}" in self._journal:
            # What it depends on, Gaussians and times, grows little from stage to stage.
            left -= self._journal[f"light seconds {number - 1}"]
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
        fusion = _FUSION_SECONDS * self._pace().frames if self.fits_fusion else 0.0
        return 60 * _USED * self._settings.minutes - self._clock.seconds() - fusion

    def _pace(self) -> Seconds:
        """Seconds that finished stages took, over the expected ones; as expected before the first."""
        expected, taken = Seconds(0.0, 0.0), Seconds(0.0, 0.0)
        for number, stage in enumerate(self.stages):
            if f"training seconds {number}" in self._journal:
                own = expected_seconds(
                    replace(stage, steps=self._journal[f"steps {number}"]), self.stages[:number]
                )
                expected = Seconds(expected.frames + own.frames, expected.training + own.training)
                frames, training = (
                    self._journal[f"{part} seconds {number}"] for part in ("frame", "training")
                )
                taken = Seconds(taken.frames + frames, taken.training + training)
        if not expected.frames:
            return AS_EXPECTED
        return Seconds(taken.frames / expected.frames, taken.training / expected.training)
