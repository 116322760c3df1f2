"""The canvas in a browser: who is answered, what counts, and a whole study in Chromium."""

from __future__ import annotations

import http.client
import json
import queue
import re
import threading
from contextlib import contextmanager, suppress
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from compose.base.errors import UserError
from hybrid.study.browser import serve_study
from tests.chromium import chromium, until
from tests.hybrid.study.scripted import ScriptedSession, phase, text, trial

_SIZE = (32, 24)


class Server:
    """A study that is being served in a thread, and requests to it."""

    def __init__(self, session, port=0):
        self.session, self.raised = session, None
        announced = queue.Queue()
        self.thread = threading.Thread(target=self._serve, args=(announced.put, port))
        self.thread.start()
        self.address = announced.get(timeout=10)
        self.port, self.query = urlsplit(self.address).port, urlsplit(self.address).query

    def _serve(self, announce, port):
        try:
            serve_study(self.session, announce, port)
        except RuntimeError as error:
            self.raised = error

    def ask(self, path, body=None, query=None, **headers):
        """Status, type of content, and content."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        target = f"{path}?{self.query if query is None else query}"
        connection.request("GET" if body is None else "POST", target, body, named)
        response = connection.getresponse()
        found = response.status, response.headers.get_content_type(), response.read()
        connection.close()
        return found

    def reply(self, **reply):
        status, _, content = self.ask("/answer", json.dumps(reply), content_type="application/json")
        return status, json.loads(content) if status == 200 else content.decode()


@contextmanager
def serving(session, port=0):
    server = Server(session, port)
    try:
        yield server
    finally:
        if server.thread.is_alive():
            session.steps = [session.steps[-1]] * 99
            # The page may have got the last step just now.
            with suppress(ConnectionError):
                server.ask("/step")
        server.thread.join(10)
        assert not server.thread.is_alive()


@pytest.fixture
def served(tmp_path):
    (tmp_path / "clips" / "a.1").mkdir(parents=True)
    (tmp_path / "clips" / "a.1" / "000000.png").write_bytes(b"picture")
    for secret in ("clips/a.1/notes.txt", "clips/000000.png", "000000.png", "study.json"):
        (tmp_path / secret).write_bytes(b"secret")
    with serving(ScriptedSession(tmp_path, text(), text())) as server:
        yield server


def test_page_steps_and_frames_are_served(served):
    status, kind, page = served.ask("/")
    assert (status, kind) == (200, "text/html")
    assert b"//" not in re.sub(rb"\s// .*", b"", page), "the page must load nothing from elsewhere"
    status, kind, step = served.ask("/step")
    assert (status, kind, json.loads(step)) == (200, "application/json", served.session.step)
    assert served.ask("/clips/a.1/000000.png") == (200, "image/png", b"picture")


@pytest.mark.parametrize("path", ["/", "/step", "/clips/a.1/000000.png", "/nowhere"])
def test_only_who_knows_the_token_is_answered(served, path):
    for query in ("", "token=", served.query[:-1], served.query + "x", served.query.lower(), "t%C3%B6ken="):
        assert served.ask(path, query=query)[0] == 403
    assert served.ask("/answer", b'{"step": 0}', query="token=", content_type="application/json")[0] == 403
    assert served.session.replies == []


def test_other_names_of_this_machine_are_refused(served):
    assert served.ask("/step", host=f"localhost:{served.port}")[0] == 200
    for host in (
        "example.com",
        f"example.com:{served.port}",
        "127.0.0.1",
        f"127.0.0.1:{served.port + 1}",
        "",
    ):
        assert served.ask("/step", host=host)[0] == 403


@pytest.mark.parametrize(
    "path",
    [
        "/study.json",
        "/clips/a.1/notes.txt",
        "/clips/000000.png",
        "/clips/../000000.png",
        "/clips/a.1/../000000.png",
        "/clips/%2e%2e/000000.png",
        "/clips//000000.png",
        "/clips/a.1/000000.PNG",
        "/clips/missing/000000.png",
        "/clips/a.1/000001.png",
        "/clips/a.1/000000.png/",
    ],
)
def test_nothing_but_frames_is_read(served, path):
    assert served.ask(path)[0] == 404


@pytest.mark.parametrize(
    ("body", "changes", "line"),
    [
        (b'{"step": 0}', {"content_type": "text/plain"}, "application/json"),
        (b'{"step": 0', {}, "not JSON"),
        (b"\xff", {}, "not JSON"),
        (b"[" * 100_000, {}, "not JSON"),
        (b'{"step": NaN}', {}, "not JSON"),
        (b"[0]", {}, "whole number"),
        (b'{"step": false}', {}, "whole number"),
        (b'{"step": "0"}', {}, "whole number"),
        (b"", {"content_length": str((1 << 23) + 1)}, "length"),
        (b"", {"content_length": "9" * 5000}, "length"),
        (b"", {"content_length": "-1"}, "length"),
        (b'{"step": 0, "values": {"age": "old"}}', {}, "age: must be a number"),
    ],
)
def test_junk_is_refused_in_one_line(served, body, changes, line):
    status, kind, content = served.ask("/answer", body, **{"content_type": "application/json"} | changes)
    assert (status, kind) == (400, "text/plain")
    assert line in content.decode()
    assert "\n" not in content.decode()
    assert served.session.replies == []


def test_a_reply_counts_once(served):
    assert served.reply(step=0) == (200, {"id": 1, **text()})
    assert served.reply(step=0) == (200, {"id": 1, **text()})
    assert served.reply(step=7) == (200, {"id": 1, **text()})
    assert served.session.replies == [{"step": 0}]


def test_serving_ends_with_the_last_step(served):
    served.reply(step=0)
    served.thread.join(0.3)
    assert served.thread.is_alive()
    assert served.reply(step=1)[1]["kind"] == "end"
    served.thread.join(10)
    assert not served.thread.is_alive()
    with pytest.raises(ConnectionRefusedError):
        served.ask("/step")


def test_what_a_session_raises_ends_serving(served):
    served.session.failure = RuntimeError("a defect")
    with pytest.raises(ConnectionError):
        served.ask("/step")
    served.thread.join(10)
    assert served.raised is served.session.failure


def test_a_taken_port_is_named(served):
    for port in (served.port, 1 << 16):
        with pytest.raises(UserError, match=f"^port {port}: cannot be served"):
            serve_study(served.session, print, port)


# In place of an eye: what is drawn, read back from the canvas. In place of a display: one of exactly 15 ms,
# however fast the machine is, whose next refresh is 115 ms late after the thirteenth picture.
_WATCH = """
window.drawn = [];
let time = performance.now() - 100000;
const draw = CanvasRenderingContext2D.prototype.drawImage, request = window.requestAnimationFrame;
CanvasRenderingContext2D.prototype.drawImage = function (image, x, y, width, height) {
  draw.apply(this, arguments);
  if (window.drawn.push([...this.getImageData(x, y, width, height).data]) === 13) time += 115;
};
window.requestAnimationFrame = (tick) => request(() => tick((time += 15)));
"""
_QUESTION = "return document.querySelectorAll('.answers button:enabled').length"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    yield from chromium(tmp_path_factory.mktemp("profile"))


@pytest.fixture
def clips(tmp_path):
    """A study's folder with clips of noise, and each clip's pixels as the canvas holds them."""
    rng = np.random.default_rng(5)
    pixels = {}
    for clip, frames in (("still", 1), ("moving", 4)):
        (tmp_path / "clips" / clip).mkdir(parents=True)
        pictures = rng.integers(0, 256, (frames, _SIZE[1], _SIZE[0], 3), np.uint8)
        for number, picture in enumerate(pictures):
            Image.fromarray(picture).save(tmp_path / "clips" / clip / f"{number:06d}.png")
        opaque = np.full((*pictures.shape[:3], 1), 255, np.uint8)
        pixels[clip] = np.concatenate([pictures, opaque], -1).reshape(frames, -1).tolist()
    return tmp_path, pixels


def _press_button(browser, label):
    until(browser, f"return document.querySelector('button:enabled')?.textContent === '{label}'")
    browser.find_element("css selector", "button").click()


def _press_key(browser, key):
    until(browser, _QUESTION)
    browser.switch_to.active_element.send_keys(key)
    until(browser, "return !document.querySelector('.answers')")


def test_a_whole_study_in_chromium(browser, clips):
    folder, pixels = clips
    fields = [
        {"name": "age", "label": "Age", "type": "text"},
        {"name": "eyes", "label": "Glasses?", "type": "choice", "choices": ["yes", "no"]},
    ]
    form = {"kind": "form", "title": "About you", "fields": fields, "button": "Go on"}
    phases = phase("still"), phase(None), phase("moving", 0.2, 4, 20.0)
    session = ScriptedSession(folder, text(), form, *[trial(*phases, size=_SIZE)] * 5)
    with serving(session) as server:
        browser.get(server.address)
        browser.execute_script(_WATCH)
        _press_button(browser, "Begin")
        _press_button(browser, "Go on")
        until(browser, "return document.querySelector('.error').textContent === 'age: must be a number'")
        browser.find_element("name", "age").send_keys("30")
        browser.find_element("css selector", "form button").click()
        for key in "1x5342":
            if key == "x":
                browser.switch_to.active_element.send_keys("1")  # No question is asked yet.
            else:
                _press_key(browser, key)
        until(browser, "return document.querySelector('h1').textContent === 'Thank you'")
        drawn = browser.execute_script("return window.drawn")
        server.thread.join(10)
    _, answered, *replies = session.replies
    assert answered == {"step": 1, "values": {"age": "30", "eyes": ""}}
    assert [reply["answer"] for reply in replies] == [1, 5, 3, 4, 2]
    asked = [100, 100, 200]
    for number, reply in enumerate(replies):
        assert reply["interval_ms"] == 15
        assert reply["reaction_ms"] > 0
        assert reply["gaze"] == []
        assert [timing["asked_ms"] for timing in reply["phases"]] == asked
        # The refreshes nearest to what is asked; in the third trial, one is late, and frame 2 is never shown.
        stalled = number == 2
        assert [timing["shown_ms"] for timing in reply["phases"]] == [105, 105, 205 if stalled else 195]
        assert [timing["dropped"] for timing in reply["phases"]] == [0, 0, int(stalled)]
        assert [timing["late"] for timing in reply["phases"]] == [0, 0, int(stalled)]
        # What is drawn is what the files hold, pixel by pixel, in order.
        frames = [0, 1, 3] if stalled else [0, 1, 2, 3]
        shown = [pixels["still"][0], *(pixels["moving"][frame] for frame in frames)]
        assert drawn[: len(shown)] == shown
        del drawn[: len(shown)]
    assert drawn == []


def test_trials_that_are_cut_short_start_again(browser, clips):
    """After the page was hidden, after a reload, and after the server was lost; time runs out at last."""
    folder, _ = clips
    step = trial(phase("still", 0.3), size=_SIZE, seconds_to_answer=0.2, least_seconds=0.1, gaze="mouse")
    session = ScriptedSession(folder, step)
    playing = "return document.body.classList.contains('playing')"
    with serving(session) as server:
        browser.get(server.address)
        _press_button(browser, "Begin")
        hidden = "Object.defineProperty(document, 'hidden', {value: %s, configurable: true});"
        browser.execute_async_script(
            "const done = arguments[0]; (function look() { if (!document.body.classList.contains('playing')) "
            f"return requestAnimationFrame(look); {hidden % 'true'} "
            f"document.dispatchEvent(new Event('visibilitychange')); {hidden % 'false'} done(); }})();"
        )
        until(browser, "return document.querySelector('h1')?.textContent === 'Interrupted'")
        browser.refresh()
        _press_button(browser, "Begin")
        until(browser, playing)
        session.failure = RuntimeError("the power is cut")
        until(browser, "return document.querySelector('h1')?.textContent === 'The connection was lost'")
        server.thread.join(10)
    assert server.raised is session.failure
    assert session.replies == []
    session.failure = None
    with serving(session, server.port) as server:
        # The old page does not know the new token.
        until(browser, "return document.querySelector('h1').textContent === 'The study cannot go on'")
        browser.get(server.address)
        _press_button(browser, "Begin")
        until(browser, "return document.querySelector('h1')?.textContent === 'Thank you'")
    (reply,) = session.replies
    assert (reply["answer"], reply["reaction_ms"]) == (None, 200)
    assert all(len(position) == 3 for position in reply["gaze"])
