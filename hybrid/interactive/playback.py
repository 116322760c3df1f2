"""The time that a scene that moves shows in the window: it plays, pauses, and is sought."""

from __future__ import annotations


class Playback:
    """Time of a scene, from 0 to 1, over the clock.

    Args:
        seconds: that the time from 0 to 1 takes at speed 1.

    Attributes:
        playing: whether time passes.
        speed: how many times as fast as the scene itself.
    """

    def __init__(self, seconds: float):
        self._seconds, self._time, self._before = seconds, 0.0, 0.0
        self.playing, self.speed = False, 1.0

    def at(self, now: float) -> float:
        """The time at `now`, in seconds of a clock that does not go back; after 1 comes 0."""
        if self.playing:
            self._time = (self._time + (now - self._before) * self.speed / self._seconds) % 1
        self._before = now
        return self._time

    def seek(self, time: float) -> None:
        """Goes to a time from 0 to 1."""
        self._time = time
