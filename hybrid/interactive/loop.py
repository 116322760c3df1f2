"""What is rendered next, how, and when: frames that keep their time, or as many as there can be."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from hybrid.interactive.request import Request, Settings
from hybrid.interactive.source import FrameSource, Shown
from hybrid.plan.controller import FrameTimeController, Rung

# Seconds without a change after which frames may take longer, for more samples each.
_PATIENT_AFTER = 1.0


class FrameLoop:
    """Makes frame after frame.

    Args:
        source: of the frames.
        ladder: measures what frames like a requested one take, with other settings.

    Attributes:
        due: time.perf_counter before which the next frame is not wanted.
        idle: whether there is nothing to be done until something else is asked for.
    """

    def __init__(self, source: FrameSource, ladder: Callable[[Request], Sequence[Rung]]):
        self._source, self._ladder = source, ladder
        self._asked: Request | None = None
        self._settings = Settings()
        self._changed = 0.0
        self._controller: FrameTimeController | None = None
        self._ladder_of: tuple[object, ...] = ()
        self._handed_out = 0.0
        self.due, self.idle = 0.0, True

    def make(self, asked: Request) -> Shown:
        """The frame that is asked for; if the last one was the same, a better one."""
        again = asked.same_picture(self._asked)
        target = asked.settings.target_fps
        if not again:
            self._asked = asked
            self._settings = asked.settings if target is None else self._controlled(asked, target)
            self._changed = time.perf_counter()
        start = time.perf_counter()
        patient = start - self._changed > _PATIENT_AFTER
        shown = self._source.show(replace(asked, settings=self._settings), patient)
        end, self.due = time.perf_counter(), 0.0
        if target is not None and self._controller is not None:
            if not again:
                self._controller.took((end - start) * 1000)
            if not patient:
                # A frame that comes early is held back: a steady rate is what was asked for.
                time.sleep(max(0.0, self._handed_out + 1 / target - end))
                # So late that the next frame is ready a period after this one: what it shows is newest then.
                self.due = time.perf_counter() + (1000 / target - self._controller.expected) / 1000
        self._handed_out = time.perf_counter()
        self.idle = shown.finished
        return shown

    def _controlled(self, asked: Request, target: float) -> Settings:
        """The settings that keep the target."""
        camera, settings = asked.camera, asked.settings
        # What a frame takes depends on these, which a person chooses.
        ladder_of = camera.width, camera.height, settings.acuity_model
        if self._controller is None or ladder_of != self._ladder_of:
            self._controller = FrameTimeController(self._ladder(asked), 1000 / target)
            self._ladder_of = ladder_of
        self._controller.target = 1000 / target
        return self._controller.choice().applied(settings)
