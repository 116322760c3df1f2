"""Keeps frames at a wanted rate: chooses among measured settings, and follows the machine."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from hybrid.interactive.request import Settings

# Share of the target that frames are planned to take: times vary.
_PLANNED = 0.85
# How quickly the controller believes that the machine has become slower, and that it is quicker again.
_SLOWER, _QUICKER = 0.5, 0.08
# Steps of the ladder that it climbs in a frame at most; down it goes at once.
_CLIMB = 0.12
# A single frame counts as no more than this many times what was expected: a hiccup is no load.
_MOST = 3.0


@dataclass(frozen=True)
class Rung:
    """Settings of a frame and what they take.

    Attributes:
        fov_a: radius in percent of the height; the band keeps its share of it.
        spp: samples per pixel in the disc.
        finest: finest layer that is drawn.
        rate: of the periphery, log2 of pixels per sample along each axis, at least.
        scale: of the rendered frame's sides to the window's.
        milliseconds: of a frame.
        quality: of it; more is better.
    """

    fov_a: float
    spp: int
    finest: int
    rate: int
    scale: float
    milliseconds: float = 0.0
    quality: float = 0.0

    def applied(self, settings: Settings) -> Settings:
        """The settings of a person, with these in place of theirs; the band keeps its share of the radius."""
        share = settings.fov_b / settings.fov_a if settings.fov_a > 0 else 0.0
        return replace(
            settings,
            fov_a=self.fov_a,
            fov_b=share * self.fov_a,
            spp=self.spp,
            layers=(1, self.finest),
            rate=self.rate,
            scale=self.scale,
        )


class FrameTimeController:
    """Chooses rungs of a ladder so that frames take the time that they may.

    Args:
        ladder: better and slower from rung to rung.
        target: milliseconds per frame.

    Raises:
        ValueError: the ladder is empty or does not rise.
    """

    def __init__(self, ladder: Sequence[Rung], target: float):
        times = [rung.milliseconds for rung in ladder]
        if not ladder or any(after <= before for before, after in pairwise(times)):
            raise ValueError("a ladder needs rungs, each slower than the one before it")
        self._ladder, self._times = list(ladder), times
        self.target = target
        # What frames take, in what was measured; where on the ladder frames are made.
        self.load = 1.0
        self._place = self._affordable()

    def choice(self) -> Rung:
        """The settings of the next frame: between two rungs the radius grows, all else is the lower one's."""
        below = int(self._place)
        rung = self._ladder[below]
        if below + 1 == len(self._ladder):
            return rung
        above, share = self._ladder[below + 1], self._place - below
        return replace(
            rung,
            fov_a=rung.fov_a + share * max(0.0, above.fov_a - rung.fov_a),
            milliseconds=rung.milliseconds + share * (above.milliseconds - rung.milliseconds),
        )

    @property
    def expected(self) -> float:
        """Milliseconds that the next frame should take, at most those of the target."""
        return min(self.choice().milliseconds * self.load, self.target)

    def took(self, milliseconds: float) -> None:
        """Learns what the frame of the last choice took."""
        relative = min(milliseconds / self.choice().milliseconds, _MOST * self.load)
        self.load += (_SLOWER if relative > self.load else _QUICKER) * (relative - self.load)
        goal = self._affordable()
        self._place = min(goal, self._place + _CLIMB)

    def _affordable(self) -> float:
        """The highest place whose frames should take the target's time."""
        budget = _PLANNED * self.target / self.load
        above = bisect_right(self._times, budget)
        if above == 0:
            return 0.0
        if above == len(self._times):
            return float(above - 1)
        before, after = self._times[above - 1], self._times[above]
        return above - 1 + (budget - before) / (after - before)
