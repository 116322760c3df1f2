"""A small forest, and servers of it on this machine."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect

from compose.camera.camera import Camera
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.messages import Request, Server, ShownFrame
from hybrid.window.remote.client import Remote
from hybrid.window.remote.protocol import SUBPROTOCOL
from hybrid.window.remote.server import Limits, Listening, ViewServer
from hybrid.window.remote.source import RemoteSource
from splat.model.forest import Forest, forest_of
from splat.model.trees import build_forest, static_layer
from tests.splat.lod.views import frame_camera
from tests.splat.samples import gaussians

TOKEN = "a token for tests"
PROTOCOLS = {"subprotocols": [SUBPROTOCOL], "compression": None, "proxy": None}
# Seconds after which a test that waits has failed.
LONG = 60.0
ACUITY = "fovvideovdp"


@pytest.fixture(scope="session")
def forest(backend) -> Forest:
    leaves = gaussians("overlap", 300, 1)
    leaves.log_scales -= 1.5
    return forest_of(build_forest(static_layer(leaves), 0.05, 2), 120.0, "overlap", "0" * 64)


@pytest.fixture(scope="session")
def camera() -> Camera:
    return frame_camera(320, 180)


def settings(level: float, most: int | None = None) -> FrameSettings:
    return FrameSettings(level=level, gaussians=most, acuity_model=ACUITY)


class Served:
    """A server that runs."""

    def __init__(self, server: ViewServer, port: int, tls: bool):
        self.server, self.port = server, port
        self.address = f"{'wss' if tls else 'ws'}://localhost:{port}"

    def link(self, token: str = TOKEN, **named) -> Remote:
        """A client, with the forest."""
        remote = Remote(Server(self.address, token, **named))
        remote.wait(lambda done, total, label: None)
        return remote


@pytest.fixture
def serve(forest, camera, own_home) -> Callable[..., contextlib.AbstractContextManager[Served]]:
    """Runs servers of the forest; arguments are those of `Limits`, and some of a server's."""

    @contextlib.contextmanager
    def running(
        tls=None, port=0, level=1.0, most=None, given=forest, traced=None, **limits
    ) -> Iterator[Served]:
        cut = settings(level, most)
        server = ViewServer(given, (camera, 4.0), cut, TOKEN, replace(Limits(), **limits), traced)
        ports: queue.Queue[int] = queue.Queue()
        loop = asyncio.new_event_loop()
        task = loop.create_task(server.run(Listening("localhost", port, tls), ports.put))

        def run() -> None:
            with contextlib.suppress(asyncio.CancelledError):
                loop.run_until_complete(task)
            loop.close()

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield Served(server, ports.get(timeout=LONG), tls is not None)
        finally:
            loop.call_soon_threadsafe(task.cancel)
            thread.join()

    return running


@contextlib.contextmanager
def admitted(served: Served, **named) -> Iterator[ClientConnection]:
    """A connection with the token, which has had its welcome."""
    headers = {"Authorization": f"Bearer {TOKEN}"}
    with connect(served.address, additional_headers=headers, **PROTOCOLS, **named) as connection:
        connection.recv(timeout=LONG)
        yield connection


class Lines(logging.Handler):
    """Lines of the log as they come."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.queue: queue.Queue[str] = queue.Queue()

    def emit(self, record: logging.LogRecord) -> None:
        self.queue.put(record.getMessage())

    def next(self) -> str:
        return self.queue.get(timeout=LONG)


@pytest.fixture
def log() -> Iterator[Lines]:
    handler, logger = Lines(), logging.getLogger("hybrid")
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    yield handler
    logger.removeHandler(handler)
    logger.setLevel(level)


def until(remote: Remote, holds: Callable[[], object]) -> None:
    """Waits for something that a client's thread brings about."""
    while not holds():
        assert remote.changed.wait(LONG)
        remote.changed.clear()


def shown_at_last(source: RemoteSource, request: Request) -> ShownFrame:
    """What a source shows once nothing better follows."""
    shown, deadline = source.show(request, quick=True), time.monotonic() + LONG
    while not shown.finished:
        assert time.monotonic() < deadline
        shown = source.show(request, quick=True)
    return shown


def drawn_leaves(remote: Remote) -> np.ndarray:
    """(N,) how many drawn nodes each leaf has above it, or is."""
    tree, nodes = remote.tree, remote.forest.hierarchy_nodes
    assert remote.cut is not None
    drawn = tree.drawn(remote.cut.split)
    found = np.zeros(nodes.leaves, int)
    at = np.arange(nodes.leaves)
    while (at >= 0).any():
        found += np.where(at >= 0, drawn[at], 0)
        at = np.where(at >= 0, nodes.parent[at], -1)
    return found
