"""The window in a browser: who is answered, what the server survives, and the page in Chromium."""

from __future__ import annotations

import asyncio
import http.client
import io
import json
import queue
import re
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from compose.base.errors import UserError
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.browser import serve_window
from hybrid.window.messages import Request, ShownFrame
from hybrid.window.render_thread import RenderThread
from hybrid.window.viewer import Viewer, WindowOptions
from tests.chromium import chromium, until
from tests.extremes import extreme
from tests.hybrid.window.fakes import Source, shown


class Spots(Source):
    """Black frames with a white disc at the gaze."""

    def show(self, request: Request, quick: bool) -> ShownFrame:
        self.requests.append(request)
        camera, gaze = request.settings.camera, request.settings.gaze
        assert camera is not None
        y, x = np.mgrid[: camera.height, : camera.width]
        near = np.hypot(x + 0.5 - gaze.x * camera.width, y + 0.5 - gaze.y * camera.height) < 12
        return shown(request, np.repeat(np.uint8(255 * near)[..., None], 3, axis=2))


class Served:
    """A window that is being served in a thread, and requests to it."""

    def __init__(self, folder: Path, prepare: Callable[..., Any] | None = None, bench: float | None = None):
        self.source = Spots()
        thread = RenderThread(prepare or (lambda report: self.source))  # type: ignore[arg-type, return-value]
        self.viewer = Viewer(thread, INTERACTIVE, None, WindowOptions((320, 240), 0.0, folder, bench=bench))
        self.raised: Exception | None = None
        announced: queue.Queue[str] = queue.Queue()
        self._thread = threading.Thread(target=self._serve, args=(announced.put,))
        self._thread.start()
        self.address = announced.get(timeout=60)
        self.port, self.query = urlsplit(self.address).port, urlsplit(self.address).query

    def _serve(self, announce: Callable[[str], object]) -> None:
        def note(address: str) -> None:
            self.loop = asyncio.get_running_loop()
            announce(address)

        try:
            serve_window(self.viewer, note)
        except (RuntimeError, UserError) as error:
            self.raised = error

    def get(self, path: str = "/", query: str | None = None, **headers: str) -> tuple[int, Any, bytes]:
        """Status, headers and content."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        target = f"{path}?{self.query if query is None else query}"
        connection.request("GET", target, headers=headers)
        response = connection.getresponse()
        found = response.status, response.headers, response.read()
        connection.close()
        return found

    def connect(self, query: str | None = None, **headers: str) -> ClientConnection:
        """A connection for events and frames."""
        host = headers.pop("host", f"127.0.0.1:{self.port}")
        uri = f"ws://{host}/events?{self.query if query is None else query}"
        made = socket.create_connection(("127.0.0.1", self.port), timeout=60)
        return connect(uri, sock=made, additional_headers=headers, max_size=None)

    def ends(self) -> None:
        """Waits until nothing is served any more."""
        self._thread.join(60)
        assert not self._thread.is_alive()
        assert not self.viewer.thread.running

    def close(self) -> None:
        if self._thread.is_alive():
            self.loop.call_soon_threadsafe(self.viewer._shell.close)
        self.ends()


@contextmanager
def serving(*given: Any, **options: Any) -> Iterator[Served]:
    served = Served(*given, **options)
    try:
        yield served
    finally:
        served.close()


@pytest.fixture
def served(tmp_path) -> Iterator[Served]:
    with serving(tmp_path) as served:
        yield served


def following(connection: ClientConnection) -> tuple[dict[str, Any], bytes]:
    """The next message, and its picture."""
    data = connection.recv(timeout=60)
    assert isinstance(data, bytes)
    (length,) = struct.unpack("<I", data[:4])
    return json.loads(data[4 : 4 + length]), data[4 + length :]


def received(connection: ClientConnection, wanted: str) -> tuple[dict[str, Any], bytes]:
    """The next message that tells something, and its picture."""
    while True:
        message, picture = following(connection)
        if wanted in message:
            return message, picture


def closed_with(connection: ClientConnection) -> int | None:
    """The code with which the server closes the connection."""
    with suppress(ConnectionClosed):
        while True:
            connection.recv(timeout=60)
    return connection.close_code


def test_the_page_is_served_and_loads_nothing_from_elsewhere(served):
    status, headers, page = served.get()
    assert (status, headers.get_content_type()) == (200, "text/html")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Cache-Control"] == "no-store"
    assert b"function hybridWindow" in page
    assert b".hybrid-window" in page
    code = re.sub(rb"\s// .*", b"", page).replace(b"ws://${location.host}", b"")
    assert b"//" not in code
    assert served.get("/nowhere")[0] == 404


def test_frames_follow_events(served):
    with served.connect() as page:
        message, picture = received(page, "frame")
        assert Image.open(io.BytesIO(picture)).size == (320, 240)
        page.send(json.dumps({"type": "shown", "frame": message["frame"]["number"], "timestamp": 1.0}))
        page.send(json.dumps({"type": "pointer_move", "x": 80, "y": 60, "timestamp": 2.0}))
        message, picture = received(page, "frame")
        while message["frame"]["x"] != 0.25:
            message, picture = received(page, "frame")
        bright = np.asarray(Image.open(io.BytesIO(picture)).convert("L")) > 128
        assert np.argwhere(bright).mean(axis=0) == pytest.approx([59.5, 79.5], abs=1)


def test_only_who_knows_the_token_gets_anything(served):
    for query in ("", "token=", served.query[:-1], served.query + "x", served.query.lower(), "t%C3%B6ken="):
        for path in ("/", "/events", "/nowhere"):
            status, _, content = served.get(path, query)
            assert status == 403
            assert b"hybrid" not in content.replace(b"hybrid demo", b"")
        with pytest.raises(InvalidStatus, match="403"), served.connect(query):
            pass


def test_other_sites_get_nothing(served):
    good = f"http://127.0.0.1:{served.port}"
    assert served.get(Host=f"localhost:{served.port}", Origin=good)[0] == 200
    for host in ("example.com", f"example.com:{served.port}", "127.0.0.1", f"127.0.0.1:{served.port + 1}"):
        assert served.get(Host=host)[0] == 403
        with pytest.raises(InvalidStatus, match="403"), served.connect(host=host):
            pass
    for origin in ("http://example.com", "null", "", good + "0", f"https://127.0.0.1:{served.port}"):
        assert served.get(Origin=origin)[0] == 403
        with pytest.raises(InvalidStatus, match="403"), served.connect(Origin=origin):
            pass
    with served.connect(Origin=good) as page:
        received(page, "frame")


@pytest.mark.parametrize(
    "sent",
    [
        b"",
        b"\x00\xff\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET /?token=\xff HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nX: " + b"x" * (1 << 20),
    ],
)
def test_what_no_browser_sends_harms_nobody(served, capfd, sent):
    with socket.create_connection(("127.0.0.1", served.port), timeout=60) as raw, suppress(ConnectionError):
        raw.sendall(sent)
        raw.shutdown(socket.SHUT_WR)
        assert b" 200 " not in raw.recv(99)
    assert served.get()[0] == 200
    assert capfd.readouterr().err == ""


def test_what_makes_no_sense_and_what_is_too_large_harms_nobody(served):
    with served.connect() as page:
        received(page, "frame")
        for message in ("{", b"\xff\xfe", "[]", '{"type": "pointer_move", "x": 1e999, "y": 0}', "[" * 9000):
            page.send(message)
        page.send(json.dumps({"type": "control", "name": "samples", "value": 3, "timestamp": 1.0}))
        assert received(page, "values")[0]["values"]["samples"][0] == 3
        page.send("x" * (1 << 20))
        assert closed_with(page) == 1009
    with served.connect() as page:
        assert received(page, "values")[0]["values"]["samples"][0] == 3


@extreme(
    "a page that shows nothing",
    given="a browser that never says that a frame was shown",
    expected="two frames, and no queue",
)
def test_a_page_that_is_never_ready_gets_two_frames(served, got):
    with served.connect() as page:
        for x in range(40):
            page.send(json.dumps({"type": "pointer_move", "x": x, "y": 60, "timestamp": float(x)}))
        page.send(json.dumps({"type": "key_down", "key": "F1", "timestamp": 50.0}))
        messages = [following(page)[0]]
        while not messages[-1].get("overlay"):
            messages.append(following(page)[0])
        assert sum("frame" in one for one in messages) <= 2
    got("two frames")


def test_a_second_page_takes_over(served):
    with served.connect() as first, served.connect() as second:
        received(second, "frame")
        assert closed_with(first) == 4001
        second.send(json.dumps({"type": "control", "name": "samples", "value": 2, "timestamp": 1.0}))
        assert received(second, "values")[0]["values"]["samples"][0] == 2


def test_what_ends_the_renderer_ends_serving(tmp_path):
    def fails(report: object) -> Any:
        raise UserError("no-such-scene: there is no such scene")

    with serving(tmp_path, fails) as served:
        served.ends()
    assert str(served.raised) == "no-such-scene: there is no such scene"


def test_a_defect_of_the_shell_ends_serving(served, monkeypatch):
    problem = RuntimeError("a defect")

    def fails(*given: object) -> Any:
        raise problem

    with served.connect() as page:
        received(page, "frame")
        monkeypatch.setattr(served.viewer, "handle", fails)
        page.send(json.dumps({"type": "blur", "timestamp": 1.0}))
        served.ends()
    assert served.raised is problem


def test_a_taken_port_is_named_before_anything_starts(served, tmp_path):
    for port in (served.port, 1 << 16):
        thread: Any = RenderThread(Any)
        other = Viewer(thread, INTERACTIVE, None, WindowOptions((64, 64), 0.0, tmp_path))
        with pytest.raises(UserError, match=f"^port {port}: cannot be served"):
            serve_window(other, print, port)
        assert not other.thread.running


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    yield from chromium(tmp_path_factory.mktemp("profile"))


def spot(browser: Any) -> list[float]:
    """Where the disc is drawn on the page's canvas, as shares of its size; empty if it is not."""
    return browser.execute_script("""
        const canvas = document.querySelector('canvas');
        const { width, height } = canvas;
        const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);
        let [count, x, y] = [0, 0, 0];
        for (let i = 0; i < data.length; i += 4)
          if (data[i] > 240) { count++; x += (i / 4) % width; y += Math.floor(i / 4 / width); }
        return count ? [x / count / width, y / count / height] : [];""")


def is_at(browser: Any, x: float, y: float) -> bool:
    return spot(browser) == pytest.approx([x, y], abs=0.02)


def move(browser: Any, x: float, y: float) -> None:
    """Moves the mouse to a point of the canvas."""
    from selenium.webdriver import ActionChains

    canvas = browser.find_element("css selector", "canvas")
    size = canvas.size
    right, down = (x - 0.5) * size["width"], (y - 0.5) * size["height"]
    ActionChains(browser).move_to_element_with_offset(canvas, round(right), round(down)).perform()


def test_the_window_in_chromium(browser, served):
    browser.get(served.address)
    until(browser, lambda: is_at(browser, 0.5, 0.5))
    assert browser.title == "box - hybrid"
    # No ring, which is bright too.
    canvas = browser.switch_to.active_element
    canvas.send_keys("gh")
    for x, y in ((0.25, 0.25), (0.8, 0.6)):
        move(browser, x, y)
        until(browser, lambda x=x, y=y: is_at(browser, x, y))
    canvas.send_keys("4")
    until(browser, "return document.querySelector('select[name=view]').value === '3'")
    browser.execute_script("""
        const slider = document.querySelector('input[name=samples]');
        slider.value = 3;
        slider.dispatchEvent(new Event('input'));""")
    until(browser, "return document.querySelector('.panel').textContent.includes('samples 3')")
    canvas.send_keys("p")
    until(browser, "return document.querySelector('.line').textContent.endsWith('and .exr')")
    # Frames follow the size of the canvas.
    browser.execute_script("document.querySelector('.canvas').style.width = '200px'")
    until(browser, lambda: served.source.requests[-1].settings.camera.width == 200)
    # A page that was loaded again goes on where the one before was.
    browser.refresh()
    until(browser, lambda: is_at(browser, 0.8, 0.6))
    assert browser.execute_script("return document.querySelector('.panel').textContent.includes('samples 3')")
    move(browser, 0.3, 0.5)
    until(browser, lambda: is_at(browser, 0.3, 0.5))
    # As in browsers that have no decoder.
    assert browser.execute_script("return delete window.ImageDecoder && !window.ImageDecoder")
    move(browser, 0.7, 0.4)
    until(browser, lambda: is_at(browser, 0.7, 0.4))
    severe = [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert not [message for message in severe if "favicon" not in message]


def test_a_page_connects_again_by_itself(browser, served):
    browser.get(served.address)
    until(browser, lambda: is_at(browser, 0.5, 0.5))
    said = "return document.querySelector('.overlay').textContent"
    with served.connect() as other:
        until(browser, f"{said}.startsWith('The window went on')")
        received(other, "frame")
    browser.refresh()
    until(browser, lambda: is_at(browser, 0.5, 0.5))
    # The connection is cut, as by a network.
    browser.execute_script("socket.close()")
    until(browser, f"{said}.startsWith('The connection was lost')")
    until(browser, f"{said} === ''")
    move(browser, 0.7, 0.3)
    until(browser, lambda: is_at(browser, 0.7, 0.3))


def test_a_bench_is_measured_in_the_page(browser, tmp_path, monkeypatch, backend):
    monkeypatch.setattr("hybrid.window.meter.WARM_UP", 0.3)
    with serving(tmp_path, bench=1.0) as served:
        browser.get(served.address)
        served.ends()
    found, _ = served.viewer.measured()
    assert (found["width"], found["height"]) == (320, 240)
    assert found["fps"] > 0
    assert found["latency_ms"]["p50"] > 0
    assert len({request.settings.gaze for request in served.source.requests}) > 5
