"""The server: tells each client which nodes of the forest to draw for its newest view.

Whatever a client sends, or leaves unsent, costs its own connection at most, and a line of the log.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import ipaddress
import logging
import socket
import ssl
import tempfile
import time
import zlib
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from http import HTTPStatus
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from compose.base.errors import UserError, one_line
from compose.camera.camera import Camera
from compose.eye.acuity import acuity_model_named
from compose.eye.detail import LayerRange, detail_map
from hybrid.base.compute_device import device_arrays
from hybrid.base.loopback import QUIET, listening, until_first
from hybrid.render.frame_settings import MOST_LEVEL, FrameSettings
from hybrid.render.periphery import continuous_levels
from hybrid.window.remote.disc_messages import DISC_WANTED, DiscMessage, DiscWanted
from hybrid.window.remote.disc_tracing import DiscServer
from hybrid.window.remote.protocol import (
    FOREST_PART,
    FOREST_WANTED,
    MOST_FOREST,
    MOST_FROM_CLIENT,
    SUBPROTOCOL,
    VIEW,
    MaskMessage,
    View,
    ViewMessage,
    Welcome,
    encoded_mask,
)
from pathtrace.scene.scene import Scene
from splat.io.forest_file import save_forest
from splat.model.forest import Forest
from splat.model.points import Bits
from splat.raster.cut import CompleteCuts

_LOG = logging.getLogger("hybrid")
# Masks on their way to a client, or back as an answer: at 60 per second, .4 seconds of them, for which one
# lost packet may hold up all that follow. First so many, and one more for each answer:
# whoever answers none must not take the time of others.
_MOST_UNANSWERED, _FIRST_UNANSWERED = 24, 2
# Bytes of the forest in one message, and bytes to a client that wait to be sent: as many messages of a mask.
_PART, _MOST_WAITING = 1 << 16, 1 << 16
# Messages of a client that wait to be read.
_MOST_UNREAD = 8
# Seconds' worth of messages that may come at once, after a delay on their way.
_BURST = 2.0
# Discs per second of one client, those that may be on their way when the view has changed, and seconds after
# which one counts as come.
_DISC_RATE, _DISCS, _DISC_ARRIVES = 30.0, 3, 0.4
# Seconds for which a disc waits at most while masks of many clients keep the thread that renders busy.
_DISC_WAITS = 1.0
# Connections that have not said who they are, for each client that there may be, and some more.
_STRANGERS_PER_CLIENT, _STRANGERS = 1, 32


@dataclass(frozen=True)
class Limits:
    """What clients may cost.

    Attributes:
        clients: at a time.
        rate: messages per second of each client.
        patience: seconds for a handshake, for the answer to a mask, and for a message to be taken.
        discs: clients at a time whose discs are traced.
    """

    clients: int = 16
    rate: float = 120.0
    patience: float = 10.0
    discs: int = 1


@dataclass(frozen=True)
class Listening:
    """Where a server listens; without TLS if there is no context."""

    host: str
    port: int
    tls: ssl.SSLContext | None = None


_FACTS = "connections", "clients", "faults", "views", "masks", "mask_bytes", "discs", "disc_bytes"
# Cut-offs do not depend on what layers there are.
_LAYERS = LayerRange(1.0, (0,))


def with_hierarchy(forest: Forest) -> Forest:
    """The forest with its hierarchy and only what splats alone are drawn with; UserError if it moves."""
    if forest.motion is not None or forest.light is not None:
        raise UserError(f"something moves in the forest of {forest.scene_name}; only still ones are served")
    return replace(forest, attached={}, hierarchy=forest.own_hierarchy)


class ViewCuts:
    """Cuts of a forest in which nothing moves.

    Args:
        forest: what is drawn.
        settings: level, acuity model, and how many Gaussians a cut has at most, of all directions.
    """

    def __init__(self, forest: Forest, settings: FrameSettings):
        self._place, self._level, self._most = forest.place, settings.level or 1.0, settings.gaussians
        self._model = acuity_model_named(settings.acuity_model)
        self._cuts = CompleteCuts(device_arrays(), forest.hierarchy_nodes)
        self.tree = self._cuts.tree

    def split(self, view: ViewMessage, before: Bits | None) -> tuple[Bits, float]:
        """Which inner nodes (M,) are split for a view, and the level that this is for.

        Most of what was split `before` stays.
        """
        camera = view.camera
        size = camera.width, camera.height
        detail = detail_map(view.display, view.gaze, *size, self._model, 0.0, _LAYERS)
        levels = continuous_levels(self._level, detail.cutoff)
        split, factor = self._cuts.split(self._place.camera(camera), levels, self._most, before)
        return split, min(self._level * factor, MOST_LEVEL)


class ViewServer:
    """Serves the cuts of one forest; backend and forest stay on a thread of their own.

    Args:
        forest: in which nothing moves.
        home: a camera for clients to start from, and the median distance to what it sees.
        settings: of cuts, see `ViewCuts`.
        token: that clients must name.
        limits: what clients may cost; also an attribute.
        traced: the scene and the whole forest, for discs; None for none.

    Attributes:
        facts: numbers of connections, of those refused or ended for a fault, and of what was sent.
    """

    def __init__(
        self,
        forest: Forest,
        home: tuple[Camera, float],
        settings: FrameSettings,
        token: str,
        limits: Limits,
        traced: tuple[Scene, Forest] | None = None,
    ):
        self.limits, self._expected = limits, f"Bearer {token}".encode()
        self._worker = ThreadPoolExecutor(1, "cuts")
        served = with_hierarchy(forest)
        content = _file_of(served)
        self._forest = zlib.compress(content)
        if len(content) > MOST_FOREST:
            raise UserError(f"a forest of {len(content):,} bytes; at most {MOST_FOREST:,} are served")
        digest = hashlib.sha256(content).hexdigest()
        sizes = len(content), len(self._forest)
        model = settings.acuity_model
        self._welcome = Welcome(forest.scene_name, *home, digest, *sizes, model, limits.rate)
        self._cuts = self._worker.submit(ViewCuts, served, settings).result()
        # Those that no client has.
        self._discs: list[DiscServer] = []
        if traced is not None:
            self._discs = self._worker.submit(
                lambda: [DiscServer(*traced, model) for _ in range(limits.discs)]
            ).result()
        self._clients: set[_Client] = set()
        self._open: set[_Connection] = set()
        # Masks that are asked for and not found yet; and whether there are none.
        self._masks, self._no_masks = 0, asyncio.Event()
        self._no_masks.set()
        self.facts = dict.fromkeys(_FACTS, 0)

    async def run(self, where: Listening, announce: Callable[[int], object]) -> None:
        """Serves until it is cancelled; `announce` gets the port. UserError if it cannot listen there."""
        limits = self.limits

        class Connection(_Connection):
            view_server = self

        with listening(f"{where.host} {where.port}"):
            server = await serve(
                self._serve,
                where.host,
                where.port,
                ssl=where.tls,
                process_request=self._admit,
                subprotocols=[Subprotocol(SUBPROTOCOL)],
                # Deflated already; and nobody can make a small message a large one.
                compression=None,
                server_header=None,
                open_timeout=limits.patience,
                ping_interval=limits.patience,
                ping_timeout=limits.patience,
                close_timeout=1.0,
                max_size=MOST_FROM_CLIENT,
                max_queue=_MOST_UNREAD,
                write_limit=_MOST_WAITING,
                logger=QUIET,
                create_connection=Connection,
            )
        try:
            async with server:
                announce(server.sockets[0].getsockname()[1])
                await server.wait_closed()
        finally:
            self._worker.shutdown()

    def opened(self, connection: _Connection) -> bool:
        """Whether one more connection can be open."""
        self.facts["connections"] += 1
        strangers = _STRANGERS_PER_CLIENT * self.limits.clients + _STRANGERS
        if len(self._open) - len(self._clients) >= strangers:
            return False
        self._open.add(connection)
        return True

    def closed(self, connection: _Connection) -> None:
        """Says in a line why a connection has ended."""
        self._open.discard(connection)
        if connection.fault:
            self.facts["faults"] += 1
            _LOG.warning("%s: %s", connection.peer, connection.fault)
        else:
            _LOG.info("%s: left", connection.peer)

    async def _admit(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuses those who do not know the token, and those who are too many."""
        assert isinstance(connection, _Connection)
        given = request.headers.get_all("Authorization")
        said = given[0].encode("utf-8", "replace") if len(given) == 1 else b""
        if not hmac.compare_digest(said, self._expected):
            connection.fault = "refused: a wrong token, or none"
            return connection.respond(HTTPStatus.UNAUTHORIZED, "a token is required\n")
        if len(self._clients) >= self.limits.clients:
            connection.fault = f"refused: there are {self.limits.clients} clients"
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "too many clients\n")
        if SUBPROTOCOL not in ", ".join(request.headers.get_all("Sec-WebSocket-Protocol")).split(", "):
            connection.fault = f"refused: speaks something else than {SUBPROTOCOL}"
            return connection.respond(HTTPStatus.BAD_REQUEST, f"only {SUBPROTOCOL} is spoken here\n")
        connection.fault = ""
        return None

    async def _serve(self, connection: ServerConnection) -> None:
        assert isinstance(connection, _Connection)
        client = _Client(connection, self.limits)
        if len(self._clients) >= self.limits.clients:
            connection.fault = f"refused: there are {self.limits.clients} clients"
            return
        self._clients.add(client)
        self.facts["clients"] += 1
        try:
            await until_first(self._read(client), self._write(client), self._stream(client))
        except ConnectionClosed:
            pass  # it says why itself
        except asyncio.TimeoutError:
            connection.fault = f"ended: took nothing for {self.limits.patience:g} s"
            connection.transport.abort()
        except ValueError as error:
            connection.fault = f"ended: sent {one_line(error)}"
            await connection.close(1008)
        except Exception:
            _LOG.exception("%s: the server failed", connection.peer)
            raise
        finally:
            self._clients.discard(client)
            if client.disc is not None:
                self._discs.append(client.disc)

    async def _read(self, client: _Client) -> None:
        async for message in client.connection:
            client.budget.take()
            if not isinstance(message, bytes) or not message:
                raise ValueError("text, or nothing")
            if message[0] == VIEW:
                client.accept(ViewMessage.unpacked(message))
                self.facts["views"] += 1
            elif message[0] == DISC_WANTED:
                client.want(DiscWanted.unpacked(message))
            elif message == bytes([FOREST_WANTED]) and not client.forest_wanted:
                client.forest_wanted = True
            else:
                raise ValueError(f"a message that begins with {message[0]}, out of place")
            client.news.set()

    async def _write(self, client: _Client) -> None:
        await client.send(self._welcome.text())
        while True:
            await client.news.wait()
            client.news.clear()
            if client.forest_wanted and not client.forest_sent:
                client.forest_sent = True
                for start in range(0, len(self._forest), _PART):
                    await client.send(bytes([FOREST_PART]) + self._forest[start : start + _PART])
            view = client.next_view()
            if view is not None:
                message = await self._mask(client, view)
                self.facts["masks"] += 1
                self.facts["mask_bytes"] += len(message)
                await client.send(message)

    async def _stream(self, client: _Client) -> None:
        """Sends a disc of the newest view after the other, and better ones while it stays."""
        on_worker = partial(asyncio.get_running_loop().run_in_executor, self._worker)
        while True:
            asked = await client.next_disc()
            if client.disc is None and self._discs:
                client.disc = self._discs.pop()
                await on_worker(client.disc.forget)
            if len(self._clients) > 1:
                # Without a mask, others have no picture at all.
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._no_masks.wait(), _DISC_WAITS)
            begin = time.monotonic()
            if client.disc is None:
                message: DiscMessage | None = DiscMessage(asked[0].sequence)
            else:
                message = await on_worker(client.disc.message, *asked, len(self._clients) > 1)
            took = time.monotonic() - begin
            # Others get at least as much time of the one thread that renders.
            waits = took if len(self._clients) > 1 else 0.0
            if message is not None:
                packed = message.packed()
                client.disc_sent(*asked, message.final)
                self.facts["discs"] += 1
                self.facts["disc_bytes"] += len(packed)
                await client.send(packed)
                waits = max(waits, 1 / _DISC_RATE - (time.monotonic() - begin))
            await asyncio.sleep(waits)

    async def _mask(self, client: _Client, view: ViewMessage) -> bytes:
        # The client may answer before the cut is found.
        base, known, before = *client.base(), client.last

        def found() -> tuple[Bits, float, bytes]:
            split, level = self._cuts.split(view, before)
            return split, level, encoded_mask(split, np.zeros_like(split) if known is None else known)

        self._masks += 1
        self._no_masks.clear()
        try:
            split, level, content = await asyncio.get_running_loop().run_in_executor(self._worker, found)
        finally:
            self._masks -= 1
            if not self._masks:
                self._no_masks.set()
        return MaskMessage(client.sends(split), base, view.sequence, level, content).packed()


class _Budget:
    """So much per second, and what was not used for some seconds as well; ValueError beyond."""

    def __init__(self, rate: float):
        self._rate, self._left, self._at = rate, rate * _BURST, time.monotonic()

    def take(self, count: float = 1.0) -> None:
        now = time.monotonic()
        self._left = min(self._left + (now - self._at) * self._rate, self._rate * _BURST) - count
        self._at = now
        if self._left < 0:
            raise ValueError("more than the server takes")


class _Client:
    """What the server knows of a client: its newest view, and masks that it may have."""

    def __init__(self, connection: _Connection, limits: Limits):
        self.connection, self.news = connection, asyncio.Event()
        self.budget, self._patience = _Budget(limits.rate), limits.patience
        self.forest_wanted = self.forest_sent = False
        self._view: ViewMessage | None = None
        # Of the newest view, of the mask that it says is there, and of the last one that was sent.
        self._sequence = self._held = self._number = 0
        # What traces its disc, and what disc it wants of each view from the next one on.
        self.disc: DiscServer | None = None
        self._wanted: DiscWanted | None = None
        self._disc_news = asyncio.Event()
        # The newest view and the disc wanted of it, what the last disc was for, and whether that was final.
        self._asked: tuple[ViewMessage, DiscWanted] | None = None
        self._disc_for: tuple[View, DiscWanted] | None = None
        self._disc_is_final = False
        # When discs were sent that may not have come yet, and after which mask.
        self._discs_sent: deque[tuple[float, int]] = deque()
        # Number of the newest mask that was ever answered, and how many later ones there may be.
        self._answered, self._window = 0, _FIRST_UNANSWERED
        # With the times when they were sent, from the one that the client is known to have; and the last one.
        self._masks: dict[int, tuple[float, NDArray[np.uint8]]] = {}
        self.last: Bits | None = None

    def accept(self, view: ViewMessage) -> None:
        """Takes note of a view; ValueError if the client cannot have sent it now."""
        if view.sequence <= self._sequence:
            raise ValueError(f"view {view.sequence} after {self._sequence}")
        if view.held and view.held not in self._masks:
            raise ValueError(f"an answer to mask {view.held}, which it does not have")
        # Whoever has none, so it says, has answered none of the others either.
        self._masks = {n: mask for n, mask in self._masks.items() if n >= view.held}
        self._window += max(0, view.held - self._answered)
        self._answered = max(view.held, self._answered)
        self._sequence, self._held, self._view = view.sequence, view.held, view
        if self._wanted is not None:
            self._asked = view, self._wanted
            self._disc_news.set()
        unanswered = [at for n, (at, _) in self._masks.items() if n > self._answered]
        if unanswered and time.monotonic() - unanswered[0] > self._patience:
            raise ValueError(f"views, but no answer to a mask for {self._patience:g} s")

    def next_view(self) -> ViewMessage | None:
        """The newest view, once, unless too many masks are unanswered."""
        if sum(n > self._answered for n in self._masks) >= min(self._window, _MOST_UNANSWERED):
            return None
        view, self._view = self._view, None
        return view

    def want(self, disc: DiscWanted) -> None:
        """Takes note of the disc that the client wants of its next views."""
        self._wanted = disc

    async def next_disc(self) -> tuple[ViewMessage, DiscWanted]:
        """What to trace next, once there is something and not too many discs are on their way."""
        while True:
            self._disc_news.clear()
            waiting, asked = None, self._asked
            if asked is not None:
                # The same view may have been sent again.
                stays = (asked[0].view, asked[1]) == self._disc_for
                if not (stays and self._disc_is_final):
                    if self._on_their_way() <= (1 if stays else _DISCS):
                        return asked
                    waiting = _DISC_ARRIVES / 4
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._disc_news.wait(), waiting)

    def _on_their_way(self) -> int:
        """Discs that may not have come: once the mask before one is answered, it soon will have."""
        sent, old = self._discs_sent, time.monotonic() - _DISC_ARRIVES
        while sent and (sent[0][1] <= self._answered or sent[0][0] < old):
            sent.popleft()
        return len(sent)

    def disc_sent(self, view: ViewMessage, wanted: DiscWanted, final: bool) -> None:
        """Notes a disc that is about to be sent."""
        self._disc_for, self._disc_is_final = (view.view, wanted), final
        self._discs_sent.append((time.monotonic(), self._number))

    def base(self) -> tuple[int, Bits | None]:
        """Number of the newest mask that the client is known to have, and that mask; 0 and None for none."""
        if not self._held or self.last is None:
            return 0, None
        packed = self._masks[self._held][1]
        return self._held, np.unpackbits(packed, count=len(self.last)).view(np.bool_)

    def sends(self, split: Bits) -> int:
        """Number of the next mask, which the client may have from now on."""
        self._number += 1
        self.last, self._masks[self._number] = split, (time.monotonic(), np.packbits(split))
        return self._number

    async def send(self, message: str | bytes) -> None:
        """Sends a message once there is room for it; TimeoutError if there is none for long."""
        await asyncio.wait_for(self.connection.send(message), self._patience)


class _Connection(ServerConnection):
    """A connection that says why it ended, and ends when a client sends too much or reads too little."""

    view_server: ViewServer
    # Why it is ended, empty if the client leaves by itself; address of the client.
    fault, peer = "ended: no handshake", "unknown"

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        # Frames of WebSockets and all.
        self._bytes = _Budget(self.view_server.limits.rate * MOST_FROM_CLIENT)
        peer = transport.get_extra_info("peername") or ("unknown", 0)
        self.peer = f"{peer[0]}:{peer[1]}"
        if not self.view_server.opened(self):
            self.fault = "refused: too many connections"
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        sent = self.protocol.close_sent
        # Not those who leave, nor all when the server goes away.
        if sent is not None and not self.protocol.close_rcvd_then_sent and sent.code != CloseCode.GOING_AWAY:
            self.fault = self.fault or f"ended: {one_line(sent.reason) or sent.code}"
        self.view_server.closed(self)

    def data_received(self, data: bytes) -> None:
        try:
            self._bytes.take(len(data))
            # Answers to pings, which wait for nothing.
            if self.transport.get_write_buffer_size() > 2 * _MOST_WAITING + _PART:
                raise ValueError("more than it reads")
        except ValueError as error:
            self.fault = f"ended: sent {error}"
            self.transport.abort()
            return
        super().data_received(data)


def _file_of(forest: Forest) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "forest.safetensors"
        save_forest(file, forest)
        return file.read_bytes()


def tls_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """TLS with a certificate and its key, PEM files; UserError if they are not that."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        # Nobody is asked for the password of a key.
        context.load_cert_chain(certificate, key, password=b"")
    except (OSError, ValueError) as error:
        raise UserError(f"{certificate}, {key}: not a certificate and its key ({one_line(error)})") from error
    return context


def is_loopback(host: str) -> bool:
    """Whether what listens on a host can be reached from this machine alone."""
    try:
        found = {entry[4][0] for entry in socket.getaddrinfo(host, None)}
        return all(ipaddress.ip_address(str(address).partition("%")[0]).is_loopback for address in found)
    except (OSError, ValueError):
        return False
