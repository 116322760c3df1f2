"""Keeps frames at a target rate by choosing among measured settings; adapts to the machine's load."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid.evaluation.measured_settings import MeasuredSettings
from hybrid.render.frame_settings import FrameSettings

# Share of the target time that frames are planned to take, because times vary.
_PLANNED = 0.85
# How quickly the controller accepts that the machine has become slower, and that it is faster again.
_SLOWER, _FASTER = 0.5, 0.08
# Largest climb per frame, in steps of the ladder; it descends at once.
_CLIMB = 0.12
# A frame counts as at most this many times the expected time, because one outlier is not a load.
_MOST = 3.0
# No machine becomes a thousand times as fast as it was when it was measured. Frames of 0 ms, which a coarse
# clock yields, would otherwise lead to a load of 0, at which any settings are affordable for ever.
_LEAST_LOAD = 1e-3


class FrameTimeController:
    """Chooses settings from a ladder so that frames take the target time, in milliseconds.

    The load is the time of a frame over the time measured for its settings, averaged over recent frames.
    ValueError if the ladder is empty, its times do not increase, or the target is not positive.
    """

    def __init__(self, ladder: Sequence[MeasuredSettings], target: float):
        times = [one.milliseconds for one in ladder]
        if not ladder or np.any(np.diff(times) <= 0):
            raise ValueError("a ladder requires settings, each slower than the one before it")
        if not target > 0:
            raise ValueError(f"target of {target} ms: must be positive")
        self._ladder, self._times = list(ladder), times
        self.target = target
        self.load = 1.0
        # On the ladder, with fractions between two settings.
        self._position = self._affordable()

    def choice(self) -> MeasuredSettings:
        """The settings of the next frame; between two on the ladder, radius and time are interpolated."""
        below = int(self._position)
        lower = self._ladder[below]
        if below + 1 == len(self._ladder):
            return lower
        upper, share = self._ladder[below + 1], self._position - below
        growth = max(0.0, upper.settings.fov_a - lower.settings.fov_a)
        return replace(
            lower,
            settings=lower.settings.with_radius(lower.settings.fov_a + share * growth),
            milliseconds=lower.milliseconds + share * (upper.milliseconds - lower.milliseconds),
        )

    @property
    def expected(self) -> float:
        """Milliseconds that the next frame is expected to take, at most the target."""
        return min(self.choice().milliseconds * self.load, self.target)

    def took(self, milliseconds: float) -> None:
        """Adapts the load and the choice to the time that the frame of the last choice took.

        A time that is negative or not finite, such as that of a frame that never ended, tells nothing about
        the load and changes nothing.
        """
        if not 0 <= milliseconds < math.inf:
            return
        relative = min(milliseconds / self.choice().milliseconds, _MOST * self.load)
        load = self.load + (_SLOWER if relative > self.load else _FASTER) * (relative - self.load)
        self.load = max(load, _LEAST_LOAD)
        self._position = min(self._affordable(), self._position + _CLIMB)

    def _affordable(self) -> float:
        """The highest position at which frames are expected to meet the target."""
        return float(np.interp(_PLANNED * self.target / self.load, self._times, np.arange(len(self._times))))


def applied(choice: MeasuredSettings, requested: FrameSettings) -> FrameSettings:
    """The requested settings with the chosen radius (the band keeps its share), samples and so on."""
    settings = choice.settings
    return replace(
        requested.with_radius(settings.fov_a),
        spp=settings.spp,
        layers=settings.layers,
        rate=settings.rate,
        scale=settings.scale,
    )
