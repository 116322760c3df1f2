"""The window in a web browser: a server for one page, on this machine and for its users only."""

from __future__ import annotations

import asyncio
import json
import struct
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from hybrid.base.loopback import ADDRESS, HEADERS, QUIET, Visitors, listening, until_first
from hybrid.window.page import MOST_BYTES, PageShell, asset
from hybrid.window.viewer import Viewer

# With which a connection is closed when another page takes over.
_TAKEN_OVER = 4001
# Seconds in which pages may say goodbye.
_PARTING = 0.5


def serve_window(viewer: Viewer, announce: Callable[[str], object], port: int = 0) -> None:
    """Serves a viewer to a browser on this machine until it is closed, or interrupted.

    One page shows the window: the newest one that was opened takes over from the one before, which says so.
    What a page leaves behind, a reloaded one too, the next one continues.

    Args:
        announce: gets the address to open once it can be, with a new token that keeps others out.
        port: of 127.0.0.1; 0 takes a free one.

    Raises:
        UserError: the port cannot be taken.
        Exception: what ended the renderer.
    """
    # After an interruption, the command goes on with what was measured.
    with suppress(KeyboardInterrupt):
        asyncio.run(_serve(viewer, announce, port))
    if viewer.error is not None:
        raise viewer.error


async def _serve(viewer: Viewer, announce: Callable[[str], object], port: int) -> None:
    visitors, shell = Visitors(), PageShell(viewer)
    with listening(f"port {port}"):
        server = await serve(
            _Pages(viewer, shell).connected,
            ADDRESS,
            port,
            process_request=partial(_answer, visitors),
            max_size=MOST_BYTES,
            compression=None,
            # A page that is busy, or whose renderer compiles, is not gone.
            ping_interval=None,
            server_header=None,
            logger=QUIET,
        )
    try:
        announce(visitors.address(server.sockets[0].getsockname()[1]))
        await shell.run()
    finally:
        server.close()
        # Connections that a browser made ahead and never used are not waited for.
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(server.wait_closed(), _PARTING)


def _answer(visitors: Visitors, connection: ServerConnection, request: Request) -> Response | None:
    """The page, or why there is none; None lets a page connect."""
    path, _, query = request.path.partition("?")
    # Headers that come twice may be read otherwise elsewhere.
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    port, origin = connection.local_address[1], origins[0] if origins else None
    if len(hosts) != 1 or len(origins) > 1 or not visitors.admits(query, hosts[0], origin, port):
        return _response(HTTPStatus.FORBIDDEN, "open the address that hybrid demo printed")
    if path == "/events":
        return None
    if path == "/":
        return _response(HTTPStatus.OK, page(), "text/html")
    return _response(HTTPStatus.NOT_FOUND, "there is no such address")


def page() -> str:
    """The page, which loads nothing else."""
    text = asset("window.html")
    for name in ("window.css", "window.js"):
        text = text.replace(f"/* {name} */", asset(name))
    return text


def _response(status: HTTPStatus, content: str, kind: str = "text/plain") -> Response:
    body = content.encode()
    headers = Headers({**HEADERS, "Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body))})
    headers["Connection"] = "close"
    return Response(status.value, status.phrase, headers, body)


class _Pages:
    """The pages that connect to a shell, one at a time."""

    def __init__(self, viewer: Viewer, shell: PageShell):
        self._viewer, self._shell = viewer, shell
        self._connection: ServerConnection | None = None

    async def connected(self, connection: ServerConnection) -> None:
        """Serves a page until it leaves or another one takes over; a defect ends the window."""
        before, self._connection = self._connection, connection

        async def send(message: dict[str, Any], picture: bytes) -> None:
            # Length and text of a message, then the picture: one message of the connection.
            text = json.dumps(message, allow_nan=False).encode()
            await connection.send(struct.pack("<I", len(text)) + text + picture)

        async def read() -> None:
            async for message in connection:
                self._shell.receive(session, message if isinstance(message, str) else "")

        session = self._shell.connect(send)
        if before is not None:
            self._parting = asyncio.ensure_future(before.close(_TAKEN_OVER, "another page has taken over"))
        try:
            await until_first(read(), session.run())
        except ConnectionClosed:
            pass
        except Exception as error:
            self._viewer.on_failure(error)
        finally:
            self._shell.disconnect(session)
