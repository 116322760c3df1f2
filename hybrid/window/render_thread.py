"""The thread on which everything is rendered; scene, forest and Dr.Jit live on it alone."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from PySide6.QtCore import QThread, Signal

from compose.base.errors import UserError
from hybrid.base.progress import Progress
from hybrid.window.frame_loop import FrameLoop, ladder_for
from hybrid.window.frame_source import FrameSource
from hybrid.window.messages import Newest, Request, ShownFrame

# Seconds between two checks of an idle thread whether it is to end.
_POLL = 0.1


class RenderThread(QThread):
    """Renders the newest of the requests, again and again as long as that makes the frame better.

    Args:
        prepare: makes the source of frames, on this thread. It is given a function that reports progress, and
            that raises KeyboardInterrupt once the window is closed.
    """

    # Activity, steps done, steps in total.
    progress = Signal(str, int, int)
    ready = Signal(object)
    # There is a frame in `frames`. If the signal carried it, frames would pile up before a busy window.
    arrived = Signal()
    # A message for the user.
    saved = Signal(str)
    failed = Signal(object)

    def __init__(self, prepare: Callable[[Progress], FrameSource]):
        super().__init__()
        self.requests: Newest[Request] = Newest()
        self.frames: Newest[ShownFrame] = Newest()
        self._prepare = prepare
        self._screenshots: Newest[Path] = Newest()
        self._stopping = threading.Event()

    def stop(self) -> None:
        """Ends the thread after the frame or step that it is at; returns when it has ended."""
        self._stopping.set()
        self.wait()

    def save(self, png: Path) -> None:
        """Asks for files of what is shown: the image as PNG, the frame's AOVs as EXR beside it."""
        self._screenshots.put(png)

    def run(self) -> None:
        """Prepares and renders; Qt calls this on the new thread."""
        try:
            source = self._prepare(self._report)
            self.ready.emit(source.ready())
            self._serve(source, FrameLoop(source, partial(ladder_for, source, report=self._report)))
        except KeyboardInterrupt:
            pass  # the window was closed during preparation
        except Exception as error:
            # The window closes, and raises it on the main thread.
            self.failed.emit(error)

    def _report(self, done: int, total: int, label: str) -> None:
        if self._stopping.is_set():
            raise KeyboardInterrupt
        self.progress.emit(label, done, total)

    def _serve(self, source: FrameSource, loop: FrameLoop) -> None:
        request: Request | None = None
        while not self._stopping.is_set():
            # Wait first, then take the request, so that its gaze is as new as can be.
            self._stopping.wait(max(0.0, loop.due - time.perf_counter()))
            newer = self.requests.take(_POLL if loop.idle else 0.0)
            png = self._screenshots.take()
            if png is not None:
                try:
                    source.save(png)
                    said = f"{png} and .exr"
                except UserError as error:
                    said = str(error)
                self.saved.emit(said)
            request = newer or request
            if request is not None and (newer is not None or not loop.idle):
                self.frames.put(loop.make(request))
                self.arrived.emit()
