"""The thread on which everything is rendered. Scene, forest and Dr.Jit live on it alone."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from PySide6.QtCore import QThread, Signal

from compose.base.errors import UserError
from compose.camera.camera import Camera
from hybrid.interactive.ladder import ladder_for
from hybrid.interactive.loop import FrameLoop
from hybrid.interactive.newest import Newest
from hybrid.interactive.request import Request
from hybrid.interactive.source import FrameSource, Shown
from hybrid.runtime.progress import Report

# Seconds after which a thread that has nothing to do looks whether it is to end.
_LOOK = 0.1


@dataclass(frozen=True)
class Ready:
    """What the window needs to know before it asks for frames.

    Attributes:
        name: of the scene.
        camera: the scene's own.
        distance: how far away things are, in units of the scene.
        layers: of the forest.
    """

    name: str
    camera: Camera
    distance: float
    layers: int


class RenderThread(QThread):
    """Renders the newest request, again and again as long as that makes it better.

    Args:
        prepare: makes the source of frames, on this thread; gets a function that reports progress, and
            raises KeyboardInterrupt when the window is closed.
    """

    progress = Signal(str, int, int)
    ready = Signal(object)
    # There is something in `frames`: frames themselves would pile up before a window that is busy.
    arrived = Signal()
    saved = Signal(str)
    failed = Signal(object)

    def __init__(self, prepare: Callable[[Report], FrameSource]):
        super().__init__()
        self.requests: Newest[Request] = Newest()
        self.frames: Newest[Shown] = Newest()
        self._prepare = prepare
        self._files: Newest[tuple[Path, Path]] = Newest()
        self._stopping = threading.Event()

    def stop(self) -> None:
        """Ends the thread after the frame or the step that it is at; returns when it has."""
        self._stopping.set()
        self.wait()

    def save(self, picture: Path, layers: Path) -> None:
        """Asks for files of what is shown."""
        self._files.put((picture, layers))

    def run(self) -> None:
        """Called by Qt, on the new thread."""
        try:
            source = self._prepare(self._report)
            layers = len(source.renderer.periphery.forest.counts)
            name = source.renderer.scene.name
            self.ready.emit(Ready(name, source.camera, source.distance(), layers))
            self._serve(source, FrameLoop(source, partial(ladder_for, source, report=self._report)))
        except KeyboardInterrupt:
            pass  # the window was closed while something was prepared
        except Exception as error:
            # The window ends, and it is raised where it can be seen.
            self.failed.emit(error)

    def _report(self, what: str, done: int, total: int) -> None:
        if self._stopping.is_set():
            raise KeyboardInterrupt
        self.progress.emit(what, done, total)

    def _serve(self, source: FrameSource, loop: FrameLoop) -> None:
        while not self._stopping.is_set():
            # The pause comes first, so that the gaze is as new as it can be.
            self._stopping.wait(max(0.0, loop.due - time.perf_counter()))
            asked, fresh = self.requests.take(_LOOK if loop.idle else 0.0)
            files, wanted = self._files.take(0.0)
            if files is not None and wanted:
                self.saved.emit(_saved(source, *files))
            if asked is not None and (fresh or not loop.idle):
                self.frames.put(loop.make(asked))
                self.arrived.emit()


def _saved(source: FrameSource, picture: Path, layers: Path) -> str:
    """Writes both files; what to tell of it."""
    try:
        source.save(picture, layers)
    except UserError as error:
        return str(error)
    return f"{picture} and {layers.suffix}"
