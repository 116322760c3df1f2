"""The thread on which everything is rendered; scene, forest and Dr.Jit live on it alone."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol, TypeAlias

from compose.base.errors import UserError
from hybrid.base.progress import Progress
from hybrid.window.frame_loop import FrameLoop, ladder_for
from hybrid.window.frame_source import FrameSource
from hybrid.window.messages import Newest, Ready, Request, ShownFrame

# Seconds between two checks of an idle thread whether it is to end.
_POLL = 0.1


class Listener(Protocol):
    """Hears of what a render thread does, wherever its messages are posted to."""

    def on_progress(self, activity: str, done: int, total: int) -> None:
        """Some steps of an activity are done, of so many in total."""

    def on_ready(self, ready: Ready) -> None:
        """The scene is prepared."""

    def on_layers(self, layers: int) -> None:
        """The forest has another number of layers from now on."""

    def on_frame(self) -> None:
        """There is a frame in `frames`: if messages carried them, they would pile up before a busy shell."""

    def on_status(self, text: str) -> None:
        """A text that holds until another one replaces it."""

    def say(self, text: str) -> None:
        """A message for the user, which soon goes away."""

    def on_failure(self, error: Exception) -> None:
        """The thread has ended with an error."""


# Has a function called soon, on the thread that the listener lives on.
Post: TypeAlias = Callable[[Callable[[], None]], object]


class RenderThread:
    """Renders the newest of the requests, again and again as long as that makes the frame better.

    Args:
        prepare: makes the source of frames, on this thread. It is given a function that reports progress, and
            that raises KeyboardInterrupt once the window is closed.
    """

    def __init__(self, prepare: Callable[[Progress], FrameSource]):
        self.requests: Newest[Request] = Newest()
        self.frames: Newest[ShownFrame] = Newest()
        self._prepare = prepare
        self._screenshots: Newest[Path] = Newest()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="render", daemon=True)

    def start(self, listener: Listener, post: Post) -> None:
        """Prepares and renders from now on; the listener hears of it through `post`."""
        self._listener, self._post = listener, post
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread after the frame or step that it is at; returns when it has ended."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    @property
    def running(self) -> bool:
        """Whether it was started and has not ended."""
        return self._thread.is_alive()

    def save(self, png: Path) -> None:
        """Asks for files of what is shown: the image as PNG, the frame's AOVs as EXR beside it."""
        self._screenshots.put(png)

    def tell(self, status: str) -> None:
        """Shows a text beside the frame until another one replaces it; may be called on any thread."""
        self._post(partial(self._listener.on_status, status))

    def _run(self) -> None:
        try:
            source = self._prepare(self._report)
            self._post(partial(self._listener.on_ready, source.ready()))
            try:
                self._serve(source, FrameLoop(source, partial(ladder_for, source, report=self._report)))
            finally:
                source.close()
        except KeyboardInterrupt:
            pass  # the window was closed during preparation
        except Exception as error:
            # The window closes, and raises it on the main thread.
            self._post(partial(self._listener.on_failure, error))

    def _report(self, done: int, total: int, label: str) -> None:
        if self._stopping.is_set():
            raise KeyboardInterrupt
        self._post(partial(self._listener.on_progress, label, done, total))

    def _serve(self, source: FrameSource, loop: FrameLoop) -> None:
        request: Request | None = None
        while not self._stopping.is_set():
            # Wait first, then take the request, so that its gaze is as new as can be.
            self._stopping.wait(max(0.0, loop.due - time.perf_counter()))
            newer = self.requests.take(_POLL if loop.idle else 0.0)
            renewed = source.renew(self._report)
            if renewed:
                self._post(partial(self._listener.on_layers, source.layers))
            png = self._screenshots.take()
            if png is not None:
                try:
                    source.save(png)
                    said = f"{png} and .exr"
                except UserError as error:
                    said = str(error)
                self._post(partial(self._listener.say, said))
            request = newer or request
            if request is not None and (newer is not None or renewed or not loop.idle):
                begun = time.perf_counter()
                shown = loop.make(request)
                if newer is not None:
                    wait = (begun - newer.asked) * 1000
                    shown = replace(shown, milliseconds={"wait": wait, **shown.milliseconds})
                # As the camera sees it that has been asked for meanwhile.
                latest = self.requests.peek()
                if latest is not None and latest.settings.camera is not None:
                    shown = source.warped(shown, latest.settings.camera)
                self.frames.put(shown)
                self._post(self._listener.on_frame)
