"""The client's end: sends the newest view, and keeps the newest cut, on a thread of its own.

Whatever happens to the connection, there is a cut to draw; the connection is made again by itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import ssl
import threading
import time
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.typing import Subprotocol

from compose.base.errors import UserError, one_line
from compose.base.files import write_whole
from compose.camera.camera import Camera
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from hybrid.base.cache_folder import home
from hybrid.base.loopback import QUIET, until_first
from hybrid.base.progress import Progress
from hybrid.window.messages import Server
from hybrid.window.remote.disc_messages import DISC, DiscMessage, DiscWanted, StreamedDisc
from hybrid.window.remote.protocol import (
    FOREST_PART,
    FOREST_WANTED,
    MASK,
    MOST_FROM_SERVER,
    SUBPROTOCOL,
    MaskMessage,
    View,
    ViewMessage,
    Welcome,
    decoded_mask,
)
from splat.io.forest_file import load_forest
from splat.model.forest import Forest
from splat.model.hierarchy import CutTree
from splat.model.points import Bits

# Seconds until a lost connection is made again, the first time and at most, and until a silent one counts as
# lost.
_FIRST_DELAY, _MOST_DELAY, _PATIENCE = 0.25, 8.0, 10.0
# Seconds until a view is sent again that a mask for an older one came after: all answers before had to wait.
_AGAIN = 0.1
# Masks that a server may use as a base; honest ones use none that is older.
_MOST_MASKS = 32
# Views that a mask or a disc may still come for: those of some seconds.
_MOST_VIEWS = 512
# Share of the views that the server takes, so that it never gets more of them.
_PACE = 0.9
_POLL = 0.1


@dataclass(frozen=True)
class Cut:
    """What the server last said of what is to be drawn.

    Attributes:
        number: of the mask, from 1 on in each connection.
        sequence: of the view that it is for, from 1 on.
        level: continuous level of detail that it is for.
        split: (M,) which inner nodes are split.
    """

    number: int
    sequence: int
    level: float
    split: Bits


class Remote:
    """A connection to a server, made again whenever it is lost.

    Attributes:
        welcome, forest, tree: from the server, once `wait` has returned.
        cut: the newest one; None before the first.
        disc: the newest one; None if the server sends none for what was looked at last.
        trouble: why there is no connection, in a line; empty while there is one.
        changed: is set when there is another cut, another disc, or other trouble.
        sent: number of the newest view that was sent, and that view.
        bytes, disc_bytes: of all masks, and of all discs, so far.
    """

    welcome: Welcome
    forest: Forest
    tree: CutTree

    def __init__(self, server: Server):
        self._address, self._token = server.address, server.token
        self._tls = _context(server.address, server.authority)
        self.cut: Cut | None = None
        self.disc: StreamedDisc | None = None
        self.trouble, self.bytes, self.disc_bytes = "not connected yet", 0, 0
        self.changed = threading.Event()
        self._view: View | None = None
        self._wanted: DiscWanted | None = None
        # From which view on the server knows what disc is wanted, and that disc.
        self._told: tuple[int, DiscWanted | None] = 1, None
        # What the newest disc is the last one for.
        self._final_for: tuple[View, DiscWanted | None] | None = None
        # The last ones that were sent, by number: they are what a mask or a disc may be for.
        self._views: dict[int, View] = {}
        self.sent: tuple[int, View | None] = 0, None
        self._progress = 0, 1
        self._ready, self._failure = threading.Event(), ""
        self._loop = asyncio.new_event_loop()
        self._task: asyncio.Task[None] | None = None
        self._news = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="remote", daemon=True)
        self._thread.start()

    def wait(self, report: Progress) -> None:
        """Returns once the forest is there; UserError if the server cannot be reached or refuses."""
        try:
            while not self._ready.wait(_POLL):
                report(*self._progress, "forest (KiB)")
                if self._failure:
                    raise UserError(f"{self._address}: {self._failure}")
        except BaseException:
            self.close()
            raise

    def look(self, camera: Camera, gaze: Gaze, display: Display) -> None:
        """Asks for the cut of a view, in place of all views that were not sent yet; never waits."""
        view = camera, gaze, display
        if view != self._view:
            self._view = view
            self._loop.call_soon_threadsafe(self._news.set)

    def want(self, disc: DiscWanted) -> None:
        """Asks for a path-traced disc of each view from now on; never waits."""
        if disc != self._wanted:
            self._wanted = disc
            self._loop.call_soon_threadsafe(self._news.set)

    @property
    def is_current(self) -> bool:
        """Whether the newest cut is one for the view that was asked for last."""
        return self.cut is not None and self._is_of_view(self.cut.sequence)

    @property
    def disc_is_final(self) -> bool:
        """Whether no other disc will follow for the view and the disc that were asked for last."""
        return self._final_for == (self._view, self._wanted)

    def _is_of_view(self, sequence: int) -> bool:
        """Whether what was sent with a number is the view that was asked for last."""
        return self._view is not None and self._views.get(sequence) is self._view

    def close(self) -> None:
        """Ends the connection; returns when it has ended."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(lambda: self._task and self._task.cancel())
            self._thread.join()

    def _run(self) -> None:
        self._task = self._loop.create_task(self._connected())
        try:
            self._loop.run_until_complete(self._task)
        except asyncio.CancelledError:
            pass
        finally:
            self._loop.run_until_complete(self._loop.shutdown_default_executor())
            self._loop.close()

    async def _connected(self) -> None:
        delay = _FIRST_DELAY
        while True:
            try:
                async with connect(
                    self._address,
                    ssl=self._tls,
                    additional_headers={"Authorization": f"Bearer {self._token}"},
                    subprotocols=[Subprotocol(SUBPROTOCOL)],
                    compression=None,
                    proxy=None,
                    open_timeout=_PATIENCE,
                    ping_interval=_PATIENCE,
                    ping_timeout=_PATIENCE,
                    close_timeout=1.0,
                    max_size=MOST_FROM_SERVER,
                    max_queue=4,
                    logger=QUIET,
                ) as connection:
                    await self._begun(connection)
                    delay, received = _FIRST_DELAY, _Received(self.tree.inner)
                    await until_first(
                        self._send_views(connection, received), self._take_messages(connection, received)
                    )
                    self._say("the connection was lost (the server has ended it)")
            except (OSError, WebSocketException, ValueError, UserError, asyncio.TimeoutError) as error:
                self._say(_said(error))
            if not self._ready.is_set():
                # Whoever starts is told why it does not work, instead of waiting.
                self._failure = self.trouble
                return
            await asyncio.sleep(delay)
            delay = min(2 * delay, _MOST_DELAY)

    def _say(self, trouble: str) -> None:
        self.trouble = trouble
        self.changed.set()

    async def _begun(self, connection: ClientConnection) -> None:
        message = await asyncio.wait_for(connection.recv(), _PATIENCE)
        if not isinstance(message, str):
            raise ValueError("a server that does not begin with a welcome")
        welcome = Welcome.of_text(message)
        if self._ready.is_set():
            if welcome.forest != self.welcome.forest:
                raise ValueError("the server shows another forest now; start again")
        else:
            file = home() / "remote" / f"{welcome.forest}.safetensors"
            if not await asyncio.to_thread(_is_whole, file, welcome):
                content = await self._downloaded(connection, welcome)
                write_whole(file, lambda part: part.write_bytes(content))
            self.forest, self.tree = await asyncio.to_thread(_loaded, file)
        self.welcome = welcome
        self._ready.set()
        self._say("")

    async def _downloaded(self, connection: ClientConnection, welcome: Welcome) -> bytes:
        """The forest's file; ValueError if it is not the one that the welcome names."""
        await connection.send(bytes([FOREST_WANTED]))
        packed = bytearray()
        while len(packed) < welcome.packed:
            part = await asyncio.wait_for(connection.recv(), _PATIENCE)
            if not isinstance(part, bytes) or len(part) < 2 or part[0] != FOREST_PART:
                raise ValueError("a server that sends something else than the forest")
            packed += part[1:]
            self._progress = len(packed) >> 10, welcome.packed >> 10
        inflating = zlib.decompressobj()
        try:
            content = inflating.decompress(packed, welcome.bytes)
        except zlib.error as error:
            raise ValueError(f"a forest that cannot be inflated ({error})") from error
        if hashlib.sha256(content).hexdigest() != welcome.forest:
            raise ValueError("a forest that is not the one that the server names")
        return content

    async def _send_views(self, connection: ClientConnection, received: _Received) -> None:
        pace, due = 1 / (_PACE * self.welcome.rate), 0.0
        self._told = self.sent[0] + 1, None
        while True:
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._news.wait(), _AGAIN)
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            self._news.clear()
            view, (sequence, _) = self._view, self.sent
            is_answered = self._is_of_view(received.sequence) and not received.has_missed
            is_told = self._told[1] == self._wanted
            if view is None or (is_answered and is_told):
                continue
            received.has_missed = False
            due = time.monotonic() + pace
            if self._wanted is not None and not is_told:
                wanted = self._wanted
                self._told = sequence + 1, wanted
                await connection.send(wanted.packed())
            # Before it is sent: its mask may come at once.
            self.sent = sequence + 1, view
            self._views[sequence + 1] = view
            self._views.pop(sequence + 1 - _MOST_VIEWS, None)
            await connection.send(ViewMessage(sequence + 1, received.held, *view).packed())

    async def _take_messages(self, connection: ClientConnection, received: _Received) -> None:
        async for message in connection:
            if not isinstance(message, bytes) or not message or message[0] not in (MASK, DISC):
                raise ValueError("a server that sends something else than masks and discs")
            if message[0] == DISC:
                self.disc_bytes += len(message)
                self._take_disc(DiscMessage.unpacked(message))
                continue
            self.bytes += len(message)
            cut = received.take(MaskMessage.unpacked(message))
            if cut is not None:
                self.cut = cut
                self.changed.set()
            else:
                # Asks again, with the base that is there.
                received.has_missed = True
                self._news.set()

    def _take_disc(self, message: DiscMessage) -> None:
        view = self._views.get(message.sequence)
        if view is None:
            # Of a view that was forgotten, or never sent.
            return
        camera, gaze, _ = view
        self.disc = StreamedDisc.of(message, camera, gaze) if message.side else None
        first, wanted = self._told
        self._final_for = (view, wanted) if message.final and message.sequence >= first else None
        self.changed.set()


class _Received:
    """The masks of one connection that later ones may be against.

    Attributes:
        held: number of the newest; 0 for none.
        sequence: of the view that it is for.
        has_missed: whether there was one that could not be taken since the last view was sent.
    """

    def __init__(self, inner: int):
        self._masks = {0: np.zeros(inner, np.bool_)}
        self.held = self.sequence = 0
        self.has_missed = False

    def take(self, message: MaskMessage) -> Cut | None:
        """The cut of a message; None if it is not newer, or against a mask that is not here.

        ValueError if its content does not fit.
        """
        base = self._masks.get(message.base)
        if base is None or message.number <= self.held:
            return None
        split = decoded_mask(message.content, base)
        self.held, self.sequence = message.number, message.sequence
        kept = {n: mask for n, mask in self._masks.items() if n == 0 or n >= message.base}
        kept[message.number] = split
        for number in sorted(kept)[1 : len(kept) - _MOST_MASKS]:
            del kept[number]
        self._masks = kept
        return Cut(message.number, message.sequence, message.level, split)


def _context(address: str, authority: Path | None) -> ssl.SSLContext | None:
    """How to recognize the server; None without TLS. UserError if the file is no certificate."""
    if not address.startswith(("ws://", "wss://")):
        raise UserError(f"server {address}: must begin with wss://, or ws:// on this machine")
    if address.startswith("ws://"):
        return None
    try:
        return ssl.create_default_context(cafile=authority)
    except (OSError, ssl.SSLError) as error:
        raise UserError(f"{authority}: cannot be read as certificates ({one_line(error)})") from error


def _said(error: Exception) -> str:
    if isinstance(error, InvalidStatus):
        refused = {401: "the server refuses the token", 503: "the server has no room for another client"}
        status = error.response.status_code
        return refused.get(status, f"the server answers with status {status}")
    if isinstance(error, ConnectionClosed):
        reason = one_line(error.rcvd.reason) if error.rcvd is not None and error.rcvd.reason else ""
        return f"the connection was lost{reason and f' ({reason})'}"
    if isinstance(error, asyncio.TimeoutError):
        return "the server does not answer"
    return one_line(error)


def _is_whole(file: Path, welcome: Welcome) -> bool:
    try:
        if file.stat().st_size != welcome.bytes:
            return False
        with file.open("rb") as opened:
            state = hashlib.sha256()
            while part := opened.read(1 << 20):
                state.update(part)
    except OSError:
        return False
    return state.hexdigest() == welcome.forest


def _loaded(file: Path) -> tuple[Forest, CutTree]:
    forest = load_forest(file)
    if forest.hierarchy is None or forest.motion is not None or forest.light is not None:
        raise ValueError("a forest without levels of detail")
    nodes = forest.hierarchy_nodes
    return forest, CutTree(nodes.parent, nodes.leaves)
