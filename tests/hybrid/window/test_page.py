"""A page's session: pace, pictures, times on the page's clock, and what a page may say."""

from __future__ import annotations

import asyncio
import io
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from compose.eye.gaze import Gaze
from hybrid.render.image_files import jpeg_bytes, png_bytes
from hybrid.window import page as module
from hybrid.window.messages import Ready
from hybrid.window.page import PageShell
from tests.hybrid.window import fakes
from tests.hybrid.window.fakes import CAMERA, shown


class Page:
    """A page that is connected to a viewer, and does what the test says."""

    def __init__(self, folder: Any, **options: Any):
        self.viewer = fakes.viewer(folder, **options)
        self.thread: Any = self.viewer.thread
        self.shell = PageShell(self.viewer)
        self.running = asyncio.ensure_future(self.shell.run())
        self.state: dict[str, Any] = {}
        self.messages: list[dict[str, Any]] = []
        self.pictures: list[bytes] = []
        self.sending: asyncio.Future[None] | None = None

    async def opened(self) -> Page:
        """Loads the scene, and connects."""
        await asyncio.sleep(0)
        self.viewer.on_ready(Ready("box", CAMERA, 2.0, 3))
        self.connect()
        return self

    def connect(self) -> None:
        if self.sending is not None:
            self.sending.cancel()
        self.session = self.shell.connect(self._send)
        self.sending = asyncio.ensure_future(self.session.run())

    async def _send(self, message: dict[str, Any], picture: bytes) -> None:
        self.messages.append(message)
        self.state |= message
        if picture:
            self.pictures.append(picture)

    def say(self, kind: str, at: float = 0.0, **more: Any) -> None:
        """What the page says at milliseconds of its clock."""
        self.shell.receive(self.session, {"type": kind, "timestamp": at, **more})

    def answer(self, image: Any = None) -> None:
        """Renders the newest request."""
        request = self.viewer.request
        assert request is not None
        self.thread.frames.put(shown(request, image))
        self.viewer.on_frame()

    async def until(self, done: Callable[[], object]) -> None:
        async def wait() -> None:
            while not done():
                await asyncio.sleep(0.005)

        await asyncio.wait_for(wait(), 60)

    async def settled(self) -> None:
        """Lets everything be sent that is going to be."""
        for _ in range(20):
            await asyncio.sleep(0.01)


@pytest.fixture
def run(tmp_path, monkeypatch) -> Any:
    """Runs a test with a page; nothing is ever still unless the test wants it."""
    monkeypatch.setattr(module, "_STILL", 3600.0)

    def run(test: Callable[[Page], Awaitable[None]], **options: Any) -> None:
        async def main() -> None:
            page = await Page(tmp_path, **options).opened()
            await test(page)
            assert page.sending is not None
            page.shell.close()
            await page.running
            assert page.thread.stopped
            page.sending.cancel()

        asyncio.run(main())

    return run


def test_at_most_two_frames_are_on_their_way_and_the_newest_wins(run):
    async def test(page: Page) -> None:
        for level in range(1, 8):
            page.answer(np.full((240, 320, 3), 30 * level, np.uint8))
            await page.until(lambda level=level: len(page.pictures) >= min(level, 2))
        await page.settled()
        assert len(page.pictures) == 2
        page.say("shown", frame=1)
        await page.until(lambda: len(page.pictures) == 3)
        await page.settled()
        # Of five that waited, the last one is sent.
        assert len(page.pictures) == 3
        levels = [np.asarray(Image.open(io.BytesIO(one))).mean() for one in page.pictures]
        assert levels == pytest.approx([30, 60, 210], abs=3)

    run(test)


def test_frames_that_were_drawn_over_make_room_too(run):
    async def test(page: Page) -> None:
        for count in (1, 2):
            page.answer()
            await page.until(lambda count=count: len(page.pictures) == count)
        page.answer()
        page.say("shown", frame=2)
        await page.until(lambda: len(page.pictures) == 3)
        assert len(page.viewer.meter.passes) == 1

    run(test)


def test_a_page_that_takes_no_frames_asks_for_none(run):
    async def test(page: Page) -> None:
        for count in (1, 2):
            page.answer()
            await page.until(lambda count=count: len(page.pictures) == count)
        page.thread.requests.take()
        page.viewer.controls.set("samples", 3)
        await page.settled()
        assert page.thread.requests.take() is None
        page.say("shown", frame=2)
        assert page.thread.requests.take().settings.spp == 3

    run(test)


def test_latency_is_on_the_clock_of_the_page(run, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])

    async def test(page: Page) -> None:
        page.answer()
        await page.until(lambda: page.pictures)
        # Messages travel for 30, 10 and 50 ms.
        now[0] = 1000.03
        page.say("shown", 0.0, frame=1)
        now[0] = 1001.01
        page.say("pointer_move", 1000.0, x=80, y=120)
        assert page.viewer.request.settings.gaze == Gaze(0.25, 0.5)
        page.answer()
        await page.until(lambda: len(page.pictures) == 2)
        now[0] = 1001.2
        page.say("shown", 1070.0, frame=2)
        assert [seconds for _, seconds in page.viewer.meter.latencies] == [pytest.approx(0.07)]
        disc = {"x": 0.25, "y": 0.5, "radius": 0.15}
        assert page.state["frame"] == {"number": 2, "type": "image/jpeg", **disc}

    run(test)


def test_a_still_view_ends_in_a_lossless_picture(run, monkeypatch):
    monkeypatch.setattr(module, "_STILL", 0.05)
    noise = np.random.default_rng(1).integers(0, 256, (240, 320, 3), np.uint8)

    async def test(page: Page) -> None:
        page.answer(noise)
        await page.until(lambda: len(page.pictures) == 2)
        first, last = (Image.open(io.BytesIO(one)) for one in page.pictures)
        assert (first.format, last.format) == ("JPEG", "PNG")
        assert (np.asarray(last) == noise).all()
        page.say("shown", frame=1)
        page.say("shown", frame=2)
        await page.settled()
        # Once is enough, and it counts as one frame.
        assert len(page.pictures) == 2
        assert len(page.viewer.meter.passes) == 1

    run(test)


def test_a_view_that_is_refined_is_nearly_lossless():
    y, x = np.mgrid[:240, :320]
    image = np.stack([x * 0.8, y, 255 - y], axis=2).astype(np.uint8)
    errors = [
        np.abs(np.asarray(Image.open(io.BytesIO(picture))) - image.astype(int)).mean()
        for picture in (jpeg_bytes(image, 85, halves_colour=True), jpeg_bytes(image, 97), png_bytes(image))
    ]
    assert errors[0] > errors[1]
    assert errors[1] < 0.7
    assert errors[2] == 0


def test_only_what_has_changed_of_the_state_is_sent(run):
    async def test(page: Page) -> None:
        await page.until(lambda: "values" in page.state)
        assert page.state["title"] == "box - hybrid"
        assert page.state["values"]["samples"] == [1, "samples 1", True]
        assert {"name": "samples", "kind": "slider", "low": 1, "high": 16, "entries": ()} in page.state[
            "controls"
        ]
        page.messages.clear()
        page.say("key_down", key="F1")
        await page.until(lambda: page.messages)
        (message,) = page.messages
        assert message.keys() == {"overlay"}
        page.viewer.on_status("learning: 31.2 dB after 40 s")
        page.viewer.say("")
        await page.until(lambda: page.state["line"].startswith("learning"))
        page.viewer.on_progress("stage 1", 2, 5)
        await page.until(lambda: page.state.get("progress") == ("stage 1", 2, 5))

    run(test)


def test_a_new_page_gets_everything_and_the_state_goes_on(run):
    async def test(page: Page) -> None:
        page.answer()
        await page.until(lambda: page.pictures)
        page.say("control", name="samples", value=3)
        page.say("key_down", key="w")
        old = page.session
        page.state.clear()
        page.connect()
        await page.until(lambda: len(page.pictures) == 2 and "values" in page.state)
        assert page.state["values"]["samples"][0] == 3
        # Keys that the page before had down are up.
        assert page.viewer.interval == 0.1
        # What that one still says does not count.
        page.shell.receive(old, {"type": "control", "name": "samples", "value": 5})
        page.shell.disconnect(old)
        assert page.viewer.controls.values["samples"] == 3
        page.say("control", name="samples", value=4)
        assert page.viewer.controls.values["samples"] == 4

    run(test)


@pytest.mark.parametrize(
    "message",
    [
        "{",
        "[" * 5000,
        b"\xff\x00",
        "null",
        "[1]",
        '"shown"',
        "{}",
        '{"type": "shown"}',
        '{"type": "shown", "frame": 1}',
        '{"type": "shown", "frame": "1", "timestamp": 1}',
        '{"type": "shown", "frame": 1e400, "timestamp": 1}',
        '{"type": "pointer_move", "x": NaN, "y": 1, "timestamp": 1}',
        '{"type": "key_down", "key": 7, "timestamp": {}}',
    ],
)
def test_messages_that_make_no_sense_are_ignored(run, message):
    async def test(page: Page) -> None:
        page.answer()
        await page.until(lambda: page.pictures)
        before = page.viewer.request
        page.shell.receive(page.session, message)
        assert page.viewer.request is before
        assert not page.viewer.meter.passes
        page.say("shown", frame=1)
        assert len(page.viewer.meter.passes) == 1

    run(test)


def test_a_bench_has_the_page_move_the_mouse(run):
    async def test(page: Page) -> None:
        page.answer()
        await page.until(lambda: page.pictures)
        assert page.state.get("path") is None
        page.say("shown", frame=1)
        await page.until(lambda: page.state.get("path"))
        assert page.state["path"]["ms"] == 8
        assert page.state["path"]["points"][0] == [0.5, 0.5]

    run(test, bench=10.0)


def test_an_error_of_the_renderer_is_shown_at_last(tmp_path):
    async def main() -> None:
        page = await Page(tmp_path).opened()
        page.viewer.on_failure(ValueError("something is wrong"))
        await asyncio.wait_for(page.running, 60)
        assert page.state["overlay"] == ["something is wrong"]
        page.sending.cancel()

    asyncio.run(main())


def test_held_keys_walk_while_they_are_held(run):
    async def test(page: Page) -> None:
        page.say("key_down", key="w")
        first = page.viewer.request.settings.camera
        await page.until(lambda: page.viewer.request.settings.camera.position[2] > first.position[2] + 0.01)
        page.say("key_up", key="w")
        last = page.viewer.request
        await page.settled()
        assert page.viewer.request is last

    run(test)


def test_a_frame_of_the_target_is_still_too(run, monkeypatch):
    """The settings that are chosen for a target are not those that were asked for."""
    monkeypatch.setattr(module, "_STILL", 0.05)

    async def test(page: Page) -> None:
        chosen = replace(page.viewer.request.settings, spp=4)
        page.thread.frames.put(shown(replace(page.viewer.request, settings=chosen)))
        page.viewer.on_frame()
        await page.until(lambda: len(page.pictures) == 2)
        assert Image.open(io.BytesIO(page.pictures[1])).format == "PNG"

    run(test)
