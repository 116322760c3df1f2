"""Connections: what servers and clients have in common, and pages for the browsers of this machine."""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager

from compose.base.errors import UserError, one_line

ADDRESS = "127.0.0.1"
# The page loads nothing from elsewhere, and tells nobody its address, which holds the token.
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; form-action 'none'; frame-ancestors 'none'; base-uri 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
# Of connections: what happens to them is told otherwise, or no error, as browsers that connect and leave.
QUIET = logging.getLogger("hybrid.websockets")
QUIET.disabled = True


@contextmanager
def listening(where: str) -> Iterator[None]:
    """UserError if a server that is started inside cannot listen there."""
    try:
        yield
    except (OSError, OverflowError) as error:
        raise UserError(f"{where}: cannot be served ({one_line(error)})") from error


async def until_first(*parts: Coroutine[None, None, None]) -> None:
    """Runs all parts of a connection until one has ended; raises its error, and cancels the others."""
    tasks = [asyncio.ensure_future(part) for part in parts]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        ended = asyncio.gather(*tasks, return_exceptions=True)
        # Again and again: before Python 3.12, wait_for may swallow a cancellation.
        while not ended.done():
            for task in tasks:
                task.cancel()
            await asyncio.wait([ended], timeout=0.05)


class Visitors:
    """Tells who may see the pages of a server: whoever knows the token in the address that it printed.

    Attributes:
        query: what addresses end with; holds the token, another one each time.
    """

    def __init__(self) -> None:
        self.query = f"token={secrets.token_urlsafe()}"

    def address(self, port: int) -> str:
        """The address to open."""
        return f"http://{ADDRESS}:{port}/?{self.query}"

    def admits(self, query: str, host: str | None, origin: str | None, port: int) -> bool:
        """Whether a request with that query and those headers comes from the page, or is for it.

        Its address must not have another site's name that was made to mean this machine, and no other site
        may ask. Browsers send no origin with addresses that were typed.
        """
        hosts = [f"{name}:{port}" for name in (ADDRESS, "localhost")]
        known = secrets.compare_digest(query.encode(), self.query.encode())
        return known and host in hosts and origin in (None, *(f"http://{name}" for name in hosts))
