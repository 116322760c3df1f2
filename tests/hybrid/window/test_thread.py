"""The thread that renders: the newest request, files, errors, and that it ends."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.window.messages import Ready, Request, ShownFrame
from hybrid.window.render_thread import RenderThread
from tests.hybrid.window.fakes import CAMERA, REQUEST, Source


def looking_at(x: float) -> Request:
    return replace(REQUEST, settings=replace(REQUEST.settings, gaze=Gaze(x, 0.5)))


def wait(done: Callable[[], object]) -> None:
    """Until something is the case, a minute at most."""
    end = time.monotonic() + 60
    while not done():
        assert time.monotonic() < end
        time.sleep(0.001)


class Heard:
    """Everything that a thread says."""

    def __init__(self) -> None:
        self.ready: list[Ready] = []
        self.failed: list[Exception] = []
        self.saved: list[str] = []
        self.statuses: list[str] = []
        self.arrived: list[None] = []
        self.progress: list[tuple[str, int, int]] = []
        self.on_ready, self.on_failure, self.say = self.ready.append, self.failed.append, self.saved.append
        self.layers: list[int] = []
        self.on_status, self.on_layers = self.statuses.append, self.layers.append

    def on_frame(self) -> None:
        self.arrived.append(None)

    def on_progress(self, *step: Any) -> None:
        self.progress.append(step)


def at_once(function: Callable[[], None]) -> None:
    function()


@pytest.fixture
def started() -> Iterator[Callable[..., tuple[RenderThread, Heard]]]:
    """Starts threads, which end with the test."""
    threads = []

    def start(prepare: Callable[..., Any]) -> tuple[RenderThread, Heard]:
        thread = RenderThread(prepare)
        threads.append(thread)
        heard = Heard()
        thread.start(heard, at_once)
        return thread, heard

    yield start
    for thread in threads:
        thread.stop()


def test_it_says_what_the_window_needs_to_know(started):
    _, heard = started(lambda report: Source())
    wait(lambda: heard.ready)
    assert heard.ready == [Ready("box", CAMERA, 2.0, 3)]


def test_a_finished_frame_is_rendered_once_and_not_on_this_thread(started):
    source = Source()
    thread, heard = started(lambda report: source)
    for number, x in enumerate((0.1, 0.2), 1):
        thread.requests.put(looking_at(x))
        wait(lambda number=number: len(heard.arrived) == number)
        frame = thread.frames.take()
        assert frame is not None
        assert frame.request == looking_at(x)
    time.sleep(0.05)
    assert [request.settings.gaze.x for request in source.requests] == [0.1, 0.2]
    assert source.threads.isdisjoint({threading.get_ident()})


def test_what_was_learnt_is_shown_without_a_request(started):
    source = Source()
    thread, heard = started(lambda report: source)
    thread.requests.put(looking_at(0.1))
    wait(lambda: len(heard.arrived) == 1)
    source.learnt = True
    wait(lambda: len(heard.arrived) == 2)
    assert source.requests == [looking_at(0.1)] * 2
    assert heard.layers == [3]
    thread.stop()
    assert source.closed


def test_an_unfinished_frame_is_rendered_again_until_it_is_finished(started):
    source = Source(finished=False)

    def show(request: Request, quick: bool, plain: Any = source.show) -> Any:
        source.finished = len(source.requests) == 4
        return plain(request, quick)

    source.show = show  # type: ignore[method-assign]
    thread, heard = started(lambda report: source)
    thread.requests.put(looking_at(0.1))
    wait(lambda: len(heard.arrived) == 5)
    time.sleep(0.05)
    assert source.requests == [looking_at(0.1)] * 5


def test_a_frame_that_is_not_due_yet_waits_and_has_the_newest_gaze(started, monkeypatch):
    class Loop:
        """Frames that come a second after one another, then never."""

        def __init__(self, source: Source, ladder: object):
            self.source, self.due, self.idle = source, 0.0, True

        def make(self, request: Request) -> Any:
            self.due = time.perf_counter() + (1.0 if not self.source.requests else 1000.0)
            return self.source.show(request, True)

    monkeypatch.setattr("hybrid.window.render_thread.FrameLoop", Loop)
    source = Source()
    thread, heard = started(lambda report: source)
    thread.requests.put(looking_at(0.1))
    wait(lambda: heard.arrived)
    thread.requests.put(looking_at(0.2))
    time.sleep(0.05)
    thread.requests.put(looking_at(0.3))
    wait(lambda: len(heard.arrived) == 2)
    assert source.requests == [looking_at(0.1), looking_at(0.3)]
    # Even though its next frame is due much later, it ends at once.
    thread.stop()
    assert not thread.running


def test_of_requests_that_come_meanwhile_only_the_newest_is_rendered(started):
    source, busy = Source(), threading.Event()

    def show(request: Request, quick: bool, plain: Any = source.show) -> Any:
        if request == looking_at(0.1):
            busy.wait(60)
        return plain(request, quick)

    source.show = show  # type: ignore[method-assign]
    thread, heard = started(lambda report: source)
    thread.requests.put(looking_at(0.1))
    wait(lambda: heard.ready)
    time.sleep(0.05)
    for x in (0.2, 0.3, 0.4):
        thread.requests.put(looking_at(x))
    busy.set()
    wait(lambda: source.requests and source.requests[-1] == looking_at(0.4))
    assert [request.settings.gaze.x for request in source.requests] == [0.1, 0.4]


def test_a_late_frame_is_shown_from_the_newest_camera(started, monkeypatch):
    source, busy, warps = Source(), threading.Event(), []
    elsewhere = looking_at(0.3)
    elsewhere = replace(elsewhere, settings=replace(elsewhere.settings, camera=CAMERA.moved_right(1.0)))

    def show(request: Request, quick: bool, plain: Any = source.show) -> Any:
        busy.wait(60)
        return plain(request, quick)

    def warp(shown: ShownFrame, newest: Camera) -> ShownFrame:
        if shown.request.settings.camera != newest:
            warps.append(newest)
            shown = replace(shown, paths=-1)
        return shown

    source.show = show  # type: ignore[method-assign]
    source.warped = warp  # type: ignore[method-assign]
    thread, heard = started(lambda report: source)
    handed, put = [], thread.frames.put
    monkeypatch.setattr(thread.frames, "put", lambda frame: (handed.append(frame), put(frame)))
    thread.requests.put(looking_at(0.1))
    wait(lambda: not thread.requests.qsize())
    thread.requests.put(elsewhere)
    busy.set()
    wait(lambda: len(heard.arrived) == 2)
    assert warps == [elsewhere.settings.camera]
    assert [(frame.request, frame.paths) for frame in handed] == [(looking_at(0.1), -1), (elsewhere, 6_789)]


def test_the_wait_before_a_frame_is_reported(started):
    thread, heard = started(lambda report: Source())
    thread.requests.put(replace(looking_at(0.1), asked=time.perf_counter() - 2))
    wait(lambda: heard.arrived)
    frame = thread.frames.take()
    assert frame is not None
    assert [*frame.milliseconds] == ["wait", "trace", "splat", "total"]
    assert frame.milliseconds["wait"] >= 2000


def test_files_are_written_and_named_and_so_is_what_is_wrong_with_them(started, tmp_path):
    thread, heard = started(lambda report: Source())
    thread.save(tmp_path / "box-001.png")
    wait(lambda: len(heard.saved) == 1)
    assert heard.saved == [f"{tmp_path / 'box-001.png'} and .exr"]
    assert (tmp_path / "box-001.png").is_file()
    thread.save(tmp_path / "missing" / "box-001.png")
    wait(lambda: len(heard.saved) == 2)
    assert heard.saved[1].endswith("cannot be written")
    assert not heard.failed


def test_progress_of_the_preparation_is_passed_on(started):
    def prepare(report: Callable[[int, int, str], None]) -> Source:
        report(1, 5, "train (steps)")
        return Source()

    _, heard = started(prepare)
    wait(lambda: heard.ready)
    assert heard.progress == [("train (steps)", 1, 5)]


def test_stopping_interrupts_the_preparation_without_an_error():
    interrupted = []

    def prepare(report: Callable[[int, int, str], None]) -> Source:
        try:
            while True:
                report(1, 5, "train (steps)")
                time.sleep(0.001)
        except KeyboardInterrupt:
            interrupted.append(True)
            raise

    thread = RenderThread(prepare)
    heard = Heard()
    thread.start(heard, at_once)
    wait(lambda: heard.progress)
    thread.stop()
    assert not thread.running
    assert interrupted
    assert not heard.failed
    assert not heard.ready


def test_errors_are_handed_over(started):
    problem = ValueError("something is wrong")

    def prepare(report: object) -> Source:
        raise problem

    thread, heard = started(prepare)
    wait(lambda: not thread.running)
    assert heard.failed == [problem]


def test_a_status_may_come_from_any_thread(started):
    thread, heard = started(lambda report: Source())
    thread.tell("learning: 31.2 dB after 40 s")
    assert heard.statuses == ["learning: 31.2 dB after 40 s"]


def test_a_thread_that_was_not_started_stops():
    thread = RenderThread(lambda report: Source())  # type: ignore[arg-type, return-value]
    thread.stop()
    assert not thread.running
