"""The window as a web page, wherever it is: what is sent to it, at which pace, and what comes back.

Messages from the page are events (see hybrid.window.viewer) with `timestamp`, milliseconds of the page's
clock, and one more: {"type": "shown", "frame", "timestamp"}, a frame is on the screen. Those to the page tell
what has changed of the viewer's state; with a picture, `frame` has its number, and where the disc is in it.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

from compose.base.errors import one_line
from compose.base.files import parse_json
from hybrid.render.image_files import jpeg_bytes, png_bytes
from hybrid.window.key_bindings import Command
from hybrid.window.messages import Request, ShownFrame
from hybrid.window.meter import MOUSE_PATH, MOVE
from hybrid.window.viewer import Viewer

# Frames that are on their way at most: one is being drawn while the next one travels.
_IN_FLIGHT = 2
# Seconds without a change after which frames are nearly lossless, and without a newer frame after which the
# last one is sent once more, lossless.
_STILL = 0.3
# Seconds for which texts wait for a frame that takes them along: a page paints once for both.
_TOGETHER = 0.05
# Of JPEG, while something moves (with half the resolution of colour) and when nothing does.
_MOVING_QUALITY, _STILL_QUALITY = 85, 97
# Bytes of a message from the page: many times those of the longest event.
MOST_BYTES = 1 << 14
# How the page moves the mouse for a bench.
_PATH = {"points": [[gaze.x, gaze.y] for gaze in MOUSE_PATH], "ms": 1000 * MOVE}

_LOG = logging.getLogger("hybrid")

# Sends a message and, unless empty, a picture.
Send: TypeAlias = Callable[[dict[str, Any], bytes], Awaitable[None]]


def asset(name: str) -> str:
    """The text of a file of the page."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


class PageSession:
    """One connection of a page to a viewer, on the thread of an event loop.

    There are never more than two frames on their way, and of frames that wait the newest one is sent. So does
    the state: only its newest differences from what the page knows are sent.
    """

    def __init__(self, viewer: Viewer, send: Send):
        self._viewer, self._send = viewer, send
        # What the page knows of the state.
        self._known: dict[str, Any] = {}
        # The newest frame, unless it was sent.
        self._frame: ShownFrame | None = None
        # The last one that was sent and is not lossless.
        self._lossy: ShownFrame | None = None
        self._on_their_way: dict[int, ShownFrame | None] = {}
        self._number = 0
        self._sent = 0.0
        # What is asked for, and since when.
        self._request: Request | None = None
        self._changed = 0.0
        # Of time.perf_counter from the page's clock, in seconds.
        self._offset = math.inf
        self._news, self._room = asyncio.Event(), asyncio.Event()
        self._news.set()

    @property
    def is_ready(self) -> bool:
        """Whether another frame could be sent."""
        return len(self._on_their_way) < _IN_FLIGHT

    def show_frame(self, shown: ShownFrame) -> None:
        """Sends a frame, unless a newer one comes before the page is ready for it."""
        self._frame = shown
        self._wake()

    def refresh(self) -> None:
        """Sends what has changed of the state."""
        self._news.set()

    def receive(self, message: object) -> None:
        """Takes a message of the page; ValueError, and nothing has changed, if it makes no sense."""
        if not isinstance(message, dict):
            raise ValueError("a message must be an object")
        at = self._time_of(message.get("timestamp"))
        if message.get("type") == "shown":
            self._on_shown(message.get("frame"), at)
        else:
            self._viewer.handle(message, at)

    async def run(self) -> None:
        """Sends until it is cancelled, or sending fails."""
        while True:
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._news.wait(), _STILL if self._lossy else None)
            self._news.clear()
            if self._frame is None or not self.is_ready:
                self._room.clear()
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._room.wait(), _TOGETHER)
            await self.flush()

    async def flush(self) -> None:
        """Sends what there is to send now."""
        state = self._state()
        message = {key: value for key, value in state.items() if self._known.get(key) != value}
        self._known, picture = state, b""
        shown, quality = self._next()
        if shown is not None:
            self._number += 1
            # A frame that is sent once more counts as shown already.
            self._on_their_way[self._number] = None if quality is None else shown
            settings = shown.request.settings
            disc = {"x": settings.gaze.x, "y": settings.gaze.y, "radius": settings.fov_a / 100}
            kind = "image/png" if quality is None else "image/jpeg"
            message["frame"] = {"number": self._number, "type": kind, **disc}
            if quality is None:
                picture = await asyncio.to_thread(png_bytes, shown.image)
            else:
                # A millisecond here is less than a thread takes to get its turn beside the renderer's.
                picture = jpeg_bytes(shown.image, quality, halves_colour=quality < _STILL_QUALITY)
        if message:
            await self._send(message, picture)

    def _next(self) -> tuple[ShownFrame | None, int | None]:
        now = time.perf_counter()
        if self._viewer.request is not self._request:
            self._request, self._changed = self._viewer.request, now
        still = now - self._changed >= _STILL
        if not self.is_ready:
            return None, None
        if self._frame is not None:
            self._lossy, self._frame, self._sent = self._frame, None, now
            return self._lossy, _STILL_QUALITY if still else _MOVING_QUALITY
        if self._lossy is None or not still or now - self._sent < _STILL:
            return None, None
        lossy, self._lossy = self._lossy, None
        return lossy, None

    def _on_shown(self, frame: object, at: float | None) -> None:
        if type(frame) is not int or at is None:
            raise ValueError(f"shown: frame {frame!r} at {at!r}")
        shown = self._on_their_way.get(frame)
        # Older ones were drawn over.
        for number in [number for number in self._on_their_way if number <= frame]:
            del self._on_their_way[number]
        if shown is not None:
            self._viewer.painted(shown, at)
        self._wake()
        self._viewer.tick()

    def _wake(self) -> None:
        self._news.set()
        if self._frame is not None and self.is_ready:
            self._room.set()

    def _time_of(self, timestamp: object) -> float | None:
        """The time.perf_counter of a time of the page's clock; differences of such times are the page's.

        The message that travelled in the shortest time tells how far the clocks are apart.
        """
        if isinstance(timestamp, bool) or not isinstance(timestamp, int | float):
            return None
        seconds = timestamp / 1000
        self._offset = min(self._offset, time.perf_counter() - seconds)
        return seconds + self._offset

    def _state(self) -> dict[str, Any]:
        viewer, controls = self._viewer, self._viewer.controls
        state: dict[str, Any] = {
            "title": viewer.title,
            "size": viewer.pixels,
            "hud": viewer.hud,
            "overlay": [str(viewer.error)] if viewer.error is not None else viewer.overlay,
            "ring": viewer.shows(Command.RING),
            "line": viewer.line,
            "progress": viewer.progress,
            "path": _PATH if viewer.mouse_moves else None,
        }
        if controls is not None:
            state["controls"] = [
                {"name": one.name, "kind": one.kind, "low": one.low, "high": one.high, "entries": one.entries}
                for one in controls.all
            ]
            state["values"] = {
                one.name: [controls.values[one.name], controls.text(one), controls.is_enabled(one.name)]
                for one in controls.all
            }
            state["panel"] = viewer.shows(Command.CONTROLS)
        return state


class PageShell:
    """Shows a viewer in the page that is connected, if any; the viewer goes on with the next one."""

    def __init__(self, viewer: Viewer):
        self._viewer = viewer
        self._session: PageSession | None = None
        self._last: ShownFrame | None = None
        self._closed, self._ticked = False, asyncio.Event()

    def connect(self, send: Send) -> PageSession:
        """A session with a page, in place of the one before."""
        self._session = PageSession(self._viewer, send)
        # The page before may have had keys or buttons down.
        self._viewer.handle({"type": "blur"})
        if self._last is not None:
            self._session.show_frame(self._last)
        self._ticked.set()
        return self._session

    def receive(self, session: PageSession, message: object) -> None:
        """Takes a message, JSON or what that says, of the session that is connected, if it makes sense."""
        if session is not self._session:
            return
        try:
            session.receive(parse_json(message) if isinstance(message, str) else message)
        except ValueError as error:
            _LOG.info("the page sent what makes no sense: %s", one_line(error))
        self._ticked.set()

    def disconnect(self, session: PageSession) -> None:
        """Ends a session; nothing is asked for until there is another one."""
        if self._session is session:
            self._session = None

    def show_frame(self, shown: ShownFrame) -> None:
        self._last = shown
        if self._session is not None:
            self._session.show_frame(shown)

    def refresh(self) -> None:
        if self._session is not None:
            self._session.refresh()
        self._ticked.set()

    def close(self) -> None:
        self._closed = True
        self._ticked.set()

    async def run(self) -> None:
        """Opens the viewer, and ticks until it is closed; then tells the page what it was closed for."""
        self._viewer.open(self, asyncio.get_running_loop().call_soon_threadsafe)
        try:
            while not self._closed:
                self._ticked.clear()
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._ticked.wait(), self._viewer.interval)
                # A page that is hidden or slow takes no frames, and needs no further ones.
                if not self._closed and self._session is not None and self._session.is_ready:
                    self._viewer.tick()
            if self._session is not None:
                await self._session.flush()
        finally:
            self._viewer.close()
