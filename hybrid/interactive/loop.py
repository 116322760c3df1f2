"""The interactive loop: what is rendered next, with which settings, and when."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from hybrid.frame.settings import FrameSettings
from hybrid.interactive.request import Request
from hybrid.interactive.shown import Shown
from hybrid.interactive.source import FrameSource
from hybrid.trade.controller import FrameTimeController, applied
from hybrid.trade.measured import MeasuredSettings

# Seconds without a change after which frames may take longer, for more samples each.
_QUICK_FOR = 1.0


class FrameLoop:
    """Renders frame after frame.

    Args:
        source: of the frames.
        ladder: measures the settings to choose from for frames like a requested one.

    Attributes:
        due: time.perf_counter before which the next frame should not begin.
        idle: whether there is nothing to do until another frame is requested.
    """

    def __init__(self, source: FrameSource, ladder: Callable[[Request], Sequence[MeasuredSettings]]):
        self._source, self._ladder = source, ladder
        self._request: Request | None = None
        self._settings: FrameSettings | None = None
        self._changed = 0.0
        self._controller: FrameTimeController | None = None
        self._measured_for: tuple[object, ...] = ()
        self._returned = 0.0
        self.due, self.idle = 0.0, True

    def make(self, request: Request) -> Shown:
        """The requested frame; a better one if the last request was the same."""
        again = request.same_frame(self._request)
        if not again or self._settings is None:
            self._request, self._settings = request, self._chosen(request)
            self._changed = time.perf_counter()
        start = time.perf_counter()
        quick = start - self._changed <= _QUICK_FOR
        shown = self._source.show(replace(request, settings=self._settings), quick)
        end, self.due = time.perf_counter(), 0.0
        if request.target_fps is not None and self._controller is not None:
            if not again:
                self._controller.took((end - start) * 1000)
            if quick:
                self._pace(end, request.target_fps, self._controller)
        self._returned = time.perf_counter()
        self.idle = shown.finished
        return shown

    def _pace(self, end: float, target_fps: float, controller: FrameTimeController) -> None:
        """Holds an early frame back, since a steady rate is wanted, and sets when the next one is due."""
        time.sleep(max(0.0, self._returned + 1 / target_fps - end))
        # As late as the next frame can begin and still be ready one period after this one: its gaze is
        # newest then.
        self.due = time.perf_counter() + (1000 / target_fps - controller.expected) / 1000

    def _chosen(self, request: Request) -> FrameSettings:
        """The requested settings, or those that keep the target."""
        settings, target_fps = request.settings, request.target_fps
        if target_fps is None:
            return settings
        camera, _ = replace(settings, scale=1.0).resolved(self._source.camera)
        # Of the user's choices, those that the measured times depend on.
        measured_for = camera.width, camera.height, settings.acuity_model
        if self._controller is None or measured_for != self._measured_for:
            self._controller = FrameTimeController(self._ladder(request), 1000 / target_fps)
            self._measured_for = measured_for
        self._controller.target = 1000 / target_fps
        return applied(self._controller.choice(), settings)
