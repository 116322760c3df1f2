"""The gaze from an eye tracker that streams it over the network (Lab Streaming Layer, through pylsl)."""

from __future__ import annotations

import time
from collections import deque
from threading import Event, Thread

from compose.base.errors import UserError

INSTALL = "a gaze stream needs pylsl: pip install 'foveated-hybrid-renderer[study]'"
# Seconds for which a stream is looked for, and of it that are kept: those of the longest trial.
_LOOKED_FOR, _KEPT = 5.0, 7200.0


class LabStream:
    """A stream of type Gaze, whose first two channels are x and y in fractions of the frame.

    UserError if pylsl is not installed, or there is no such stream.
    """

    def __init__(self, looked_for: float = _LOOKED_FOR):
        """Looks for the stream, for so many seconds."""
        try:
            import pylsl
        except (ImportError, RuntimeError) as error:
            raise UserError(INSTALL) from error
        found = pylsl.resolve_byprop("type", "Gaze", 1, looked_for)
        if not found:
            raise UserError("gaze stream: there is none of type Gaze; start the eye tracker's first")
        if found[0].channel_count() < 2:
            raise UserError("gaze stream: needs two channels, x and y in fractions of the frame")
        # Times on this machine's clock.
        self._inlet = pylsl.StreamInlet(found[0], processing_flags=pylsl.proc_clocksync)
        self._now = pylsl.local_clock
        self._gazes: deque[tuple[float, float, float]] = deque()
        self._ended = Event()
        self._thread = Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._ended.is_set():
            samples, times = self._inlet.pull_chunk(timeout=0.1)
            self._gazes.extend((at, one[0], one[1]) for one, at in zip(samples, times, strict=True))
            while self._gazes and self._gazes[0][0] < self._now() - _KEPT:
                self._gazes.popleft()
            if not samples:
                time.sleep(0.005)

    def last(self, seconds: float) -> list[tuple[float, float, float]]:
        """Gazes of the last seconds: seconds ago, x and y in fractions of the frame."""
        now = self._now()
        return [(now - at, x, y) for at, x, y in list(self._gazes) if at >= now - seconds]

    def close(self) -> None:
        """Ends the stream."""
        self._ended.set()
        self._thread.join()
        self._inlet.close_stream()
