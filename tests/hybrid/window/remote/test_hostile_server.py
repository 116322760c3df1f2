"""Whatever a server sends, the client says in a line what is wrong, and keeps what it has."""

from __future__ import annotations

import contextlib
import hashlib
import json
import queue
import threading
import zlib
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from compose.base.errors import UserError
from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from hybrid.base.cache_folder import home
from hybrid.window.messages import Server
from hybrid.window.remote import client as client_module
from hybrid.window.remote.client import Remote
from hybrid.window.remote.protocol import (
    FOREST_PART,
    SUBPROTOCOL,
    MaskMessage,
    ViewMessage,
    Welcome,
)
from hybrid.window.remote.protocol import encoded_mask as encoded
from hybrid.window.remote.server import _file_of, with_hierarchy
from tests.hybrid.window.remote.conftest import ACUITY, LONG, TOKEN, until

DISPLAY = DISPLAYS["desktop"]


class Scripted:
    """A server that does to each connection what it is told."""

    def __init__(self) -> None:
        self.scripts: queue.Queue = queue.Queue()
        self._server = serve(
            self._act, "localhost", 0, subprotocols=[SUBPROTOCOL], compression=None, max_size=None
        )
        self.address = f"ws://localhost:{self._server.socket.getsockname()[1]}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _act(self, connection: ServerConnection) -> None:
        # The client may leave.
        with contextlib.suppress(ConnectionClosed, OSError):
            self.scripts.get(timeout=LONG)(connection)

    def close(self) -> None:
        # For connections that wait to be told, which shutting down waits for.
        for _ in range(100):
            self.scripts.put(lambda connection: None)
        self._server.shutdown()


@pytest.fixture
def scripted(own_home) -> Iterator[Scripted]:
    server = Scripted()
    yield server
    server.close()


@pytest.fixture(scope="module")
def content(forest) -> bytes:
    return _file_of(with_hierarchy(forest))


@pytest.fixture(scope="module")
def welcome(content, camera) -> dict:
    packed, digest = len(zlib.compress(content)), hashlib.sha256(content).hexdigest()
    made = Welcome("overlap", camera, 4.0, digest, len(content), packed, ACUITY, 100.0)
    return json.loads(made.text())


def starts(scripted, script) -> str:
    """What a client says that such a server keeps from starting."""
    scripted.scripts.put(script)
    with pytest.raises(UserError) as caught:
        Remote(Server(scripted.address, TOKEN)).wait(lambda done, total, label: None)
    said = str(caught.value)
    assert "\n" not in said
    assert len(said) < 400
    return said


CHANGES = [
    ({"version": 1}, "another version"),
    ({"bytes": 0}, "a forest of 0 bytes"),
    ({"bytes": 1 << 40}, "a forest of"),
    ({"packed": 1 << 40}, "a forest of"),
    ({"packed": "many"}, "says something else"),
    ({"forest": "../" * 22}, "hash"),
    ({"forest": "z" * 64}, "hash"),
    ({"forest": 5}, "hash"),
    ({"rate": -1}, "rate"),
    ({"distance": 0}, "distance"),
    ({"acuity_model": "none of these"}, "acuity model"),
    ({"camera": None}, "says something else"),
    ({"camera": {"world_to_camera": [[1]]}}, "says something else"),
    ({"more": 1}, "says something else"),
    ({"scene": ["a"]}, "scene name"),
    ({"scene": "../../a"}, "no path"),
    ({"bytes": 1e3}, "whole numbers"),
    ({"packed": 1e3}, "whole numbers"),
]


@pytest.mark.parametrize(("change", "said"), CHANGES)
def test_a_welcome_that_is_none_is_one_line(scripted, welcome, change, said):
    assert said in starts(scripted, lambda connection: connection.send(json.dumps(welcome | change)))


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (b"bytes", "does not begin with a welcome"),
        ("not JSON", "Expecting value"),
        ("[]", "says something else"),
        ("[" * 10_000, "nested too deeply"),
        ("{}" + " " * 20_000, "a welcome of 20002 characters"),
        ("x" * (1 << 25), "lost|big"),
    ],
)
def test_a_first_message_that_is_no_welcome_is_one_line(scripted, message, said):
    found = starts(scripted, lambda connection: (connection.send(message), connection.recv()))
    assert any(part in found for part in said.split("|")), found


def forest_of(part: bytes, welcome: dict):
    """A script that sends that for the forest, a kilobyte at a time."""

    def script(connection: ServerConnection) -> None:
        connection.send(json.dumps(welcome))
        connection.recv()
        for start in range(0, len(part), 1024):
            connection.send(bytes([FOREST_PART]) + part[start : start + 1024])
        connection.recv()

    return script


def test_a_forest_that_is_another_is_one_line_and_is_not_kept(scripted, welcome, content):
    damaged = bytearray(zlib.compress(content))
    damaged[len(damaged) // 2] ^= 1
    other = zlib.compress(content[:-1] + b"x")
    # A gigabyte of zeros: no more is inflated than was announced.
    bomb = zlib.compress(bytes(1 << 24), 9)
    cases = [
        (bytes(damaged), "inflated|not the one"),
        (other + bytes(max(0, welcome["packed"] - len(other))), "not the one"),
        (bomb + bytes(max(0, welcome["packed"] - len(bomb))), "not the one"),
    ]
    for part, said in cases:
        found = starts(scripted, forest_of(part, welcome))
        assert any(one in found for one in said.split("|")), found
    assert not (home() / "remote").exists()


def test_a_file_that_is_no_forest_is_one_line(scripted, welcome):
    for junk in (b"nothing of the kind", bytes(1000)):
        named = {"forest": hashlib.sha256(junk).hexdigest(), "bytes": len(junk)}
        packed = zlib.compress(junk)
        said = starts(scripted, forest_of(packed, welcome | named | {"packed": len(packed)}))
        assert ".safetensors" in said


def test_something_else_than_the_forest_is_one_line(scripted, welcome):
    def script(connection: ServerConnection) -> None:
        connection.send(json.dumps(welcome))
        connection.recv()
        connection.send(b"\x04nothing")
        connection.recv()

    assert "something else than the forest" in starts(scripted, script)


@pytest.fixture
def following(scripted, welcome, content) -> Iterator[tuple[Scripted, Remote]]:
    """A client that has its forest and one cut, and comes back at once whenever it is thrown out."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(client_module, "_FIRST_DELAY", 0.0)
        monkeypatch.setattr(client_module, "_MOST_DELAY", 0.0)
        scripted.scripts.put(forest_of(zlib.compress(content), welcome))
        remote = Remote(Server(scripted.address, TOKEN))
        remote.wait(lambda done, total, label: None)
        yield scripted, remote
        remote.close()


def good(inner: int, number: int = 1, base: int = 0, split=None) -> bytes:
    zeros = np.zeros(inner, bool)
    split = ~zeros if split is None else split
    return MaskMessage(number, base, 1, 1.0, encoded(split, zeros)).packed()


def test_masks_that_do_not_fit_end_the_connection_and_leave_the_cut(following, welcome, camera):
    scripted, remote = following
    inner = remote.tree.inner
    bad = [
        ("text", "something else than masks and discs"),
        (b"", "something else than masks and discs"),
        (b"\x09abc", "something else than masks and discs"),
        (b"\x04abc", "a mask of 4 bytes"),
        (b"\x06abc", "a disc of 4 bytes"),
        (good(inner, 2)[:-3], "does not end"),
        (good(inner, 2) + b"x", "does not end"),
        (good(inner + 1, 2), "mask of node"),
        (MaskMessage(2, 2, 1, 1.0, b"").packed(), "mask 2 against 2"),
        (MaskMessage(2, 0, 1, float("nan"), b"").packed(), "level nan"),
        (MaskMessage(2, 0, 1, 1e6, b"").packed(), "level 1e+06"),
        (bytes([4]) + bytes(1 << 25), "lost"),
    ]
    for message, said in bad:

        def script(connection: ServerConnection, message=message) -> None:
            connection.send(json.dumps(welcome))
            connection.send(good(inner))
            connection.send(message)
            connection.recv()

        remote.trouble = ""
        scripted.scripts.put(script)
        remote.look(camera, Gaze(), DISPLAY)
        until(remote, lambda said=said: said in remote.trouble)
        assert "\n" not in remote.trouble
        assert remote.cut is not None
        assert remote.cut.split.all()


def test_masks_that_are_late_or_against_others_are_ignored_and_asked_for_again(following, welcome, camera):
    scripted, remote = following
    inner = remote.tree.inner
    nothing, heard = np.zeros(inner, bool), queue.Queue()

    def script(connection: ServerConnection) -> None:
        connection.send(json.dumps(welcome))
        connection.send(good(inner, 5))
        # Late: another is newer. Lost: nobody has number 7.
        connection.send(good(inner, 3, split=nothing))
        connection.send(good(inner, 8, base=7, split=nothing))
        while True:
            heard.put(ViewMessage.unpacked(connection.recv()))

    scripted.scripts.put(script)
    remote.look(camera, Gaze(), DISPLAY)
    while heard.get(timeout=LONG).held != 5:
        pass
    assert remote.cut is not None
    assert remote.cut.number == 5
    assert remote.cut.split.all()


def test_so_many_masks_are_kept_at_most(forest):
    inner = len(forest.own_hierarchy)
    received = client_module._Received(inner)
    for number in range(1, 200):
        assert received.take(MaskMessage.unpacked(good(inner, number))) is not None
    assert len(received._masks) <= 33
    # The newest can still be a base.
    assert received.take(MaskMessage.unpacked(good(inner, 300, base=199))) is not None


@given(st.binary(max_size=64) | st.binary(min_size=209, max_size=209))
def test_any_bytes_are_a_message_or_refused(message):
    for kind in (ViewMessage, MaskMessage):
        with contextlib.suppress(ValueError):
            assert kind.unpacked(message).packed()[1:] == message[1:]
