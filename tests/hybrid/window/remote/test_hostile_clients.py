"""Whatever a client sends, or does not, costs its own connection and a line of the log; others are served."""

from __future__ import annotations

import contextlib
import itertools
import re
import socket
import struct
from dataclasses import replace

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from hybrid.window.remote.protocol import FOREST_WANTED, SUBPROTOCOL, VIEW, MaskMessage, ViewMessage
from tests.extremes import extreme
from tests.hybrid.window.remote.conftest import LONG, PROTOCOLS, TOKEN, admitted, until

DISPLAY = DISPLAYS["desktop"]


def view(camera, sequence: int = 1, held: int = 0) -> bytes:
    return ViewMessage(sequence, held, camera, Gaze(), DISPLAY).packed()


def mask(connection: ClientConnection) -> MaskMessage:
    return MaskMessage.unpacked(connection.recv(timeout=LONG))


def read_to_the_end(connection: ClientConnection) -> None:
    """Returns once the server has ended the connection."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            connection.recv(timeout=LONG)


def is_served(served, camera) -> None:
    """An honest client gets its cut."""
    remote = served.link()
    remote.look(camera, Gaze(), DISPLAY)
    until(remote, lambda: remote.is_current)
    remote.close()


def ends(served, log, sent: list, said: str) -> None:
    """Messages end a connection for that reason."""
    with admitted(served) as connection:
        with contextlib.suppress(ConnectionClosed):
            for message in sent:
                connection.send(message)
        read_to_the_end(connection)
    line = log.next()
    assert re.fullmatch(rf"[\w.:]+: ended: .*(?:{said}).*", line), line


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Authorization": "Bearer wrong"},
        {"Authorization": f"bearer {TOKEN}"},
        {"Authorization": f"Bearer {TOKEN} "[:-2]},
        [("Authorization", f"Bearer {TOKEN}"), ("Authorization", "Bearer wrong")],
    ],
)
def test_nobody_gets_in_without_the_token(serve, log, headers):
    with serve() as served:
        with pytest.raises(InvalidStatus) as refused:  # noqa: SIM117
            with connect(served.address, additional_headers=headers, **PROTOCOLS):
                pass
        assert refused.value.response.status_code == 401
        assert log.next().endswith("refused: a wrong token, or none")
        assert served.server.facts["clients"] == 0


def test_another_protocol_is_refused(serve, log):
    other = {"additional_headers": {"Authorization": f"Bearer {TOKEN}"}, "subprotocols": ["hybrid-remote-1"]}
    with serve() as served, pytest.raises(InvalidStatus) as refused, connect(served.address, **other):
        pass
    assert refused.value.response.status_code == 400


def changed(message: bytes, at: int, kind: str, *values) -> bytes:
    """A message with other numbers at a place."""
    made = bytearray(message)
    struct.pack_into("<" + kind, made, at, *values)
    return bytes(made)


# Where the numbers of a view lie: pose, sides, focal lengths and so on, gaze, display.
POSE, SIDES, LENS, GAZE, SHOWN = 9, 137, 141, 173, 189


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((POSE, "d", np.nan), "not finite"),
        ((POSE, "d", 2.0), "not rigid"),
        ((POSE + 24, "d", np.inf), "not finite"),
        ((SIDES, "HH", 0, 540), "must be positive"),
        ((SIDES, "HH", 65535, 65535), "at most 8192"),
        ((LENS, "d", -1.0), "not positive"),
        ((GAZE, "d", np.nan), "finite"),
        ((GAZE, "d", 1e9), "not within"),
        ((SHOWN, "HH", 65535, 1), "at most 8192"),
        ((SHOWN + 4, "d", 180.0), "less than 180"),
        ((SHOWN + 4, "d", np.nan), "positive number"),
    ],
)
def test_a_view_of_numbers_out_of_range_ends_the_connection(serve, log, camera, change, said):
    with serve() as served:
        ends(served, log, [changed(view(camera), *change)], said)
        is_served(served, camera)


def test_messages_out_of_place_end_the_connection(serve, log, camera):
    known = view(camera)
    cases = [
        (["text"], "text, or nothing"),
        ([b""], "text, or nothing"),
        ([b"\x00" * 40], "begins with 0"),
        ([known[:-1]], "a view of 208 bytes"),
        ([known + b"x"], "a view of 210 bytes"),
        ([bytes([VIEW])], "a view of 1 bytes"),
        ([bytes([FOREST_WANTED])] * 2, "begins with 1, out of place"),
        ([view(camera, 5), view(camera, 5)], "view 5 after 5"),
        ([view(camera, 5), view(camera, 4)], "view 4 after 5"),
        ([view(camera, 0)], "view 0 after 0"),
        ([view(camera, 1, held=7)], "an answer to mask 7, which it does not have"),
        ([bytes(513)], "message too big|1009|exceeds"),
        ([bytes(100_000)], "more than|message too big|1009|exceeds"),
    ]
    with serve() as served:
        for sent, said in cases:
            ends(served, log, sent, said)
        assert served.server.facts["faults"] == len(cases)
        is_served(served, camera)


def test_an_answer_to_a_mask_before_one_that_was_answered_ends_the_connection(serve, log, camera):
    with serve() as served, admitted(served) as connection:
        for sequence in (1, 2):
            connection.send(view(camera, sequence, held=sequence - 1))
            assert mask(connection).number == sequence
        connection.send(view(camera, 3, held=2))
        assert mask(connection).base == 2
        connection.send(view(camera, 4, held=1))
        with pytest.raises(ConnectionClosed):
            mask(connection)
        assert "an answer to mask 1" in log.next()


def test_more_messages_than_the_rate_end_the_connection(serve, log, camera):
    with serve(rate=20.0) as served, admitted(served) as connection:
        with contextlib.suppress(ConnectionClosed):
            for sequence in itertools.count(1):
                connection.send(view(camera, sequence))
        assert "more than the server takes" in log.next()


@pytest.mark.parametrize("held", [0, 1])
def test_who_asks_without_answering_gets_few_masks_and_is_ended(serve, log, camera, held):
    with serve(patience=1.0, rate=10_000.0) as served, admitted(served) as connection:
        with contextlib.suppress(ConnectionClosed):
            connection.send(view(camera, 1))
            mask(connection)
            for sequence in itertools.count(2):
                connection.send(view(camera, sequence, held))
                with contextlib.suppress(TimeoutError):
                    connection.recv(timeout=0.005)
        assert "no answer to a mask for 1 s" in log.next()
        # Two, and as many more as were answered, after the first.
        assert served.server.facts["masks"] == 2 + 2 * held


def test_a_client_that_says_it_has_nothing_gets_a_whole_mask(serve, camera):
    with serve() as served, admitted(served) as connection:
        connection.send(view(camera, 1))
        first = mask(connection)
        connection.send(view(camera, 2, held=1))
        assert mask(connection).base == 1
        connection.send(view(camera, 3, held=0))
        whole = mask(connection)
        assert (whole.base, whole.number) == (0, 3)
        assert whole.content == first.content


def slow_reader(port: int) -> socket.socket:
    """A connection whose small buffer was known from the start: a window that shrinks stalls both ways."""
    for family, kind, protocol, _, address in socket.getaddrinfo("localhost", port, type=socket.SOCK_STREAM):
        raw = socket.socket(family, kind, protocol)
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        raw.settimeout(LONG)
        with contextlib.suppress(ConnectionRefusedError):
            raw.connect(address)
            return raw
        raw.close()
    raise ConnectionRefusedError(port)


def test_pings_whose_answers_nobody_reads_end_the_connection(serve, log, camera):
    with serve(rate=100_000.0) as served:
        raw = slow_reader(served.port)
        raw.sendall(
            f"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {'A' * 22}==\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: {SUBPROTOCOL}\r\nAuthorization: Bearer {TOKEN}\r\n\r\n".encode()
        )
        ping = bytes([0x89, 0x80 | 125]) + bytes(4) + bytes(125)
        with contextlib.suppress(ConnectionError):
            while True:
                raw.sendall(100 * ping)
        raw.close()
        assert "more than" in log.next()
        is_served(served, camera)


def test_a_reader_too_slow_for_the_forest_is_ended(serve, log, camera):
    with serve(patience=1.0) as served:
        # More than the buffers of a connection hold.
        served.server._forest = bytes(1 << 25)
        with admitted(served, max_queue=1) as connection:
            connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.send(bytes([FOREST_WANTED]))
            assert re.search("took nothing for 1 s|keepalive", log.next())


def test_garbage_and_silence_are_ended(serve, log, camera):
    with serve(patience=1.0) as served:
        garbage = socket.create_connection(("localhost", served.port), timeout=LONG)
        garbage.sendall(bytes(range(256)) * 8 + b"\r\n\r\n")
        while garbage.recv(4096):
            pass
        assert "no handshake" in log.next()
        silent = socket.create_connection(("localhost", served.port), timeout=LONG)
        is_served(served, camera)
        assert "left" in log.next()
        assert silent.recv(1) == b""
        assert "no handshake" in log.next()
        garbage.close()
        silent.close()


def test_there_are_so_many_clients_at_most(serve, log, camera):
    with serve(clients=2) as served:
        with admitted(served), admitted(served):
            with pytest.raises(InvalidStatus) as refused, admitted(served):
                pass
            assert refused.value.response.status_code == 503
            assert log.next().endswith("refused: there are 2 clients")
        assert {log.next().split(": ")[1] for _ in range(2)} == {"left"}
        is_served(served, camera)


@extreme(
    "more connections than a server takes",
    given="connections that say nothing",
    expected="refused beyond a number",
)
def test_there_are_so_many_strangers_at_most(serve, log, camera, got):
    with serve(clients=1) as served, contextlib.ExitStack() as stack:
        for _ in range(33):
            stack.enter_context(socket.create_connection(("localhost", served.port), timeout=LONG))
        another = stack.enter_context(socket.create_connection(("localhost", served.port), timeout=LONG))
        with contextlib.suppress(ConnectionResetError):
            assert another.recv(1) == b""
        assert log.next().endswith("refused: too many connections")
    got("refused")


def test_a_client_that_is_ended_while_its_cut_is_found_leaves_others_alone(serve, camera):
    with serve() as served:
        for _ in range(5):
            with admitted(served) as connection:
                connection.send(view(camera))
                connection.socket.shutdown(socket.SHUT_RDWR)
        is_served(served, replace(camera, width=640))
