"""The viewer, with a renderer that answers at once or not at all: what it asks for, and what it shows."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from compose.eye.gaze import Gaze, GazeTrace, load_gaze_trace
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.key_bindings import Command
from hybrid.window.messages import Ready, Request, ShownView
from hybrid.window.viewer import fitted
from tests.hybrid.window import fakes
from tests.hybrid.window.fakes import CAMERA, shown

HERE, THERE = Gaze(0.25, 0.5), Gaze(0.75, 0.5)


class Opened:
    """A viewer, its renderer, and a shell that shows frames at once."""

    def __init__(self, folder: Path, **options: Any):
        self.viewer = fakes.viewer(folder, **options)
        self.thread: Any = self.viewer.thread
        self.shown: list[Any] = []
        self.refreshed, self.closed = 0, False
        post: list[Callable[[], None]] = []
        self.viewer.open(self, post.append)

    def show_frame(self, shown: Any) -> None:
        self.shown.append(shown)

    def refresh(self) -> None:
        self.refreshed += 1

    def close(self) -> None:
        self.closed = True

    def load(self, seconds: float | None = None) -> None:
        """Loads the scene."""
        self.viewer.on_ready(Ready("box", CAMERA, 2.0, 3, seconds))

    def asked(self) -> Request | None:
        """The request that is new since the last call."""
        return self.thread.requests.take()

    def answer(self, **other: Any) -> None:
        """Renders the newest request and shows the frame."""
        request = self.viewer.request
        assert request is not None
        self.thread.frames.put(shown(request, **other))
        self.viewer.on_frame()
        self.viewer.painted(self.shown[-1], time.perf_counter())

    def look(self, gaze: Gaze) -> None:
        """Moves the mouse."""
        self.viewer.handle({"type": "pointer_move", "x": 320 * gaze.x, "y": 240 * gaze.y})

    def event(self, kind: str, **parts: object) -> None:
        self.viewer.handle({"type": kind, **parts})

    def key(self, key: str) -> None:
        self.event("key_down", key=key)
        self.event("key_up", key=key)


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    return now


@pytest.fixture
def make(clock, tmp_path) -> Any:
    """Opens viewers."""
    return lambda **options: Opened(tmp_path, **options)


@pytest.fixture
def opened(make) -> Opened:
    """A viewer whose scene is loaded."""
    opened = make()
    opened.load()
    opened.asked()
    return opened


def test_nothing_is_asked_for_before_the_scene_is_loaded(make):
    opened = make()
    assert opened.thread.started
    opened.look(HERE)
    for key in ("1", "r", "p", "t", "Tab", "w"):
        opened.key(key)
    assert opened.asked() is None
    assert not opened.thread.files


def test_a_loaded_scene_is_asked_for_with_the_initial_settings(make):
    opened = make(target_fps=24.5)
    opened.load()
    request = opened.asked()
    assert request.settings == replace(INTERACTIVE, camera=CAMERA)
    assert (request.view, request.target_fps) == (ShownView.COMPOSITE, 24.5)
    assert opened.viewer.request is request
    assert opened.viewer.title == "box - hybrid"


def test_the_mouse_is_the_gaze_of_the_next_request(opened, clock):
    clock[0] = 105.0
    opened.look(HERE)
    request = opened.asked()
    assert request.settings.gaze == HERE
    assert request.gaze_time == 105.0
    # The same frame is not asked for again.
    clock[0] = 106.0
    opened.viewer.tick()
    assert opened.asked() is None


def test_latency_counts_from_the_mouse_to_the_painted_frame(opened, clock):
    opened.answer()
    clock[0] = 105.0
    opened.look(HERE)
    clock[0] = 105.06
    opened.answer()
    assert list(opened.viewer.meter.latencies) == [(105.06, pytest.approx(0.06))]
    assert [seconds for _, seconds in opened.viewer.meter.intervals] == [pytest.approx(5.06)]
    assert opened.viewer.shown.request.settings.gaze == HERE


def test_a_late_gaze_is_asked_for_when_it_is_known(make, clock):
    opened = make(latency=0.1)
    opened.load()
    opened.asked()
    clock[0] = 105.0
    opened.look(HERE)
    clock[0] = 105.09
    opened.viewer.tick()
    assert opened.asked() is None
    clock[0] = 105.11
    opened.viewer.tick()
    request = opened.asked()
    assert (request.settings.gaze, request.gaze_time) == (HERE, 105.0)
    clock[0] = 105.15
    opened.answer()
    assert [seconds for _, seconds in opened.viewer.meter.latencies] == [pytest.approx(0.15)]


def test_a_trace_replaces_the_mouse(make, clock):
    opened = make(trace=GazeTrace((0.0, 1.0, 2.0), (HERE, THERE, THERE)))
    opened.load()
    assert opened.asked().settings.gaze == HERE
    clock[0] = 101.5
    opened.viewer.tick()
    assert opened.asked().settings.gaze == THERE
    opened.look(Gaze(0.1, 0.1))
    assert opened.asked() is None


def test_a_held_gaze_stays_and_holding_it_is_no_movement(opened, clock):
    opened.answer()
    clock[0] = 101.0
    opened.look(HERE)
    opened.answer()
    opened.key(" ")
    before = len(opened.viewer.meter.latencies)
    opened.asked()
    clock[0] = 110.0
    opened.look(THERE)
    assert opened.asked() is None
    clock[0] = 120.0
    opened.key(" ")
    assert opened.asked().settings.gaze == THERE
    opened.answer()
    assert len(opened.viewer.meter.latencies) == before == 1


def test_a_change_of_settings_is_no_movement(opened, clock):
    opened.answer()
    clock[0] = 101.0
    opened.event("control", name="samples", value=3)
    assert opened.asked().settings.spp == 3
    opened.answer()
    assert not opened.viewer.meter.latencies


def test_held_keys_walk_until_they_are_released(opened, clock):
    clock[0] = 103.0
    opened.event("key_down", key="w")
    clock[0] = 103.5
    opened.event("key_down", key="W", repeat=True)
    # Half a second at 0.3 of two units a second.
    assert opened.asked().settings.camera.position == pytest.approx([0, 0, 0.3])
    clock[0] = 104.0
    opened.viewer.tick()
    assert opened.asked().settings.camera.position == pytest.approx([0, 0, 0.6])
    opened.event("key_up", key="w")
    clock[0] = 105.0
    opened.viewer.tick()
    assert opened.asked() is None
    opened.key("r")
    assert opened.asked().settings.camera == CAMERA


@pytest.mark.parametrize("view", ShownView)
def test_number_keys_choose_the_view(opened, view):
    opened.key("3")
    opened.asked()
    opened.key(str(1 + list(ShownView).index(view)))
    assert opened.viewer.request.view is view


def test_a_scene_that_moves_plays_and_pauses(make, clock):
    window = make()
    window.load(seconds=4.0)
    assert window.asked().settings.time == 0
    clock[0] += 1
    window.viewer.tick()
    assert window.asked() is None
    window.key("m")
    clock[0] += 1
    window.viewer.tick()
    assert window.asked().settings.time == pytest.approx(0.25)
    assert window.viewer.controls.values["time"] == 250
    window.key("m")
    clock[0] += 1
    window.viewer.tick()
    assert window.asked() is None
    window.event("control", name="time", value=800)
    window.viewer.tick()
    assert window.asked().settings.time == pytest.approx(0.8)


def test_a_scene_that_stands_still_does_not_play(opened):
    opened.asked()
    opened.key("m")
    opened.viewer.tick()
    assert opened.asked() is None
    assert "play" not in opened.viewer.controls.values


def test_keys_that_mean_nothing_do_nothing(opened):
    for key in ("x", "9", "", "Shift", "Ö"):
        opened.key(key)
    assert opened.asked() is None


def test_screenshots_are_numbered(opened, tmp_path):
    opened.key("p")
    opened.key("p")
    assert opened.thread.files == [tmp_path / "box-001.png", tmp_path / "box-002.png"]
    opened.viewer.say("box-001.png and .exr")
    assert opened.viewer.line == "box-001.png and .exr"


def test_a_folder_that_cannot_be_read_is_a_message(opened, monkeypatch):
    def fails(self: Path) -> bool:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "exists", fails)
    opened.key("p")
    assert opened.viewer.line.endswith("cannot be read (Permission denied)")
    assert not opened.thread.files


def test_the_gaze_is_recorded_as_it_is_asked_for(opened, clock, tmp_path):
    opened.key("t")
    assert opened.viewer.line == "recording the gaze"
    for clock[0], gaze in ((101.0, HERE), (102.5, THERE)):
        opened.look(gaze)
    opened.key("t")
    assert opened.viewer.line == str(tmp_path / "box-gaze-001.csv")
    trace = load_gaze_trace(tmp_path / "box-gaze-001.csv")
    assert trace == GazeTrace((0.0, 1.0, 2.5), (Gaze(), HERE, THERE))


def test_controls_and_keys_before_the_scene_is_loaded_change_nothing(make):
    opened = make()
    assert opened.viewer.progress == ("loading the scene", 0, 0)
    with pytest.raises(ValueError, match="samples"):
        opened.event("control", name="samples", value=3)
    assert opened.viewer.controls is None
    opened.load()
    assert opened.viewer.progress is None
    assert opened.viewer.line == "F1: help"


def test_the_shell_ticks_often_only_while_something_may_change(make, opened):
    viewer = opened.viewer
    assert viewer.interval == 0.1
    opened.event("key_down", key="w")
    assert viewer.interval == 0.008
    opened.event("key_up", key="w")
    assert viewer.interval == 0.1
    for other in (make(latency=0.01), make(trace=GazeTrace((0.0,), (HERE,)))):
        assert other.viewer.interval == 0.008
    playing = make()
    playing.load(seconds=4.0)
    playing.key("m")
    assert playing.viewer.interval == 0.008


def test_keys_and_buttons_are_up_once_another_window_gets_them(opened, clock):
    opened.event("key_down", key="w")
    opened.event("pointer_down", x=10, y=10, button=1)
    opened.event("blur")
    opened.asked()
    clock[0] += 1
    opened.event("pointer_move", x=10, y=200)
    assert opened.asked().settings.camera == CAMERA


def test_dragging_moves_the_scene_with_the_hand(opened):
    # Half a height to the right: the camera turns left by half of its field of view.
    opened.event("pointer_down", x=100, y=100, button=1)
    opened.event("pointer_move", x=220, y=100)
    half = np.radians(CAMERA.vertical_fov / 2)
    forward = opened.asked().settings.camera.camera_to_world[:3, 2]
    assert forward == pytest.approx([-np.sin(half), 0, np.cos(half)])
    # A quarter downwards: it turns up.
    opened.event("pointer_move", x=220, y=160)
    turned = opened.asked().settings.camera
    assert turned.camera_to_world[1, 2] == pytest.approx(-np.sin(half / 2))
    # Neither without a button, nor with another one.
    opened.event("pointer_up", x=220, y=160, button=1)
    opened.event("pointer_down", x=220, y=160, button=2)
    opened.event("pointer_move", x=20, y=20)
    assert opened.asked().settings.camera == turned


def test_keys_show_and_hide_texts_ring_and_controls(opened):
    viewer = opened.viewer
    opened.answer()
    for key, what in (
        ("h", Command.HUD),
        ("g", Command.RING),
        ("Tab", Command.CONTROLS),
        ("F1", Command.HELP),
    ):
        before, refreshed = viewer.shows(what), opened.refreshed
        assert before == (what is not Command.HELP)
        opened.key(key)
        assert viewer.shows(what) != before
        assert opened.refreshed > refreshed
    assert viewer.hud == []
    assert any(line.startswith("Space") for line in viewer.overlay)
    for key in ("h", "F1"):
        opened.key(key)
    assert viewer.hud
    assert viewer.overlay == []


def test_a_key_that_is_held_acts_once(opened):
    opened.event("key_down", key="h")
    opened.event("key_down", key="h", repeat=True)
    assert not opened.viewer.shows(Command.HUD)


def test_messages_go_away_and_the_status_stays(opened, clock):
    viewer = opened.viewer
    viewer.on_status("learning: 31.2 dB after 40 s")
    assert viewer.line == "F1: help"
    clock[0] += 5.1
    refreshed = opened.refreshed
    viewer.tick()
    assert viewer.line == "learning: 31.2 dB after 40 s"
    assert opened.refreshed > refreshed
    viewer.say("box-001.png and .exr")
    assert viewer.line == "box-001.png and .exr"
    clock[0] += 5.1
    viewer.tick()
    assert viewer.line == "learning: 31.2 dB after 40 s"


def test_progress_counts_as_no_frame(opened, clock):
    opened.answer()
    opened.viewer.on_progress("measuring settings", 2, 5)
    assert opened.viewer.progress == ("measuring settings", 2, 5)
    opened.viewer.on_progress("measuring settings", 5, 5)
    assert opened.viewer.progress is None
    clock[0] = 130.0
    opened.answer()
    assert not opened.viewer.meter.intervals


def test_frames_follow_a_new_size_once_it_has_settled(opened, clock):
    # A scaled screen has several pixels to one of the shell's.
    opened.event("resize", width=150, height=100, pwidth=300, pheight=200)
    assert opened.asked() is None
    assert opened.viewer.interval == 0.008
    clock[0] += 0.19
    opened.event("resize", width=160, height=100, pwidth=320, pheight=200)
    clock[0] += 0.19
    opened.viewer.tick()
    assert opened.asked() is None
    clock[0] += 0.02
    opened.viewer.tick()
    camera = opened.asked().settings.camera
    assert (camera.width, camera.height) == opened.viewer.pixels == (320, 200)


def test_a_frame_fits_the_canvas_in_its_own_proportions():
    assert fitted((320, 240), (160, 60)) == (0, 60, 320, 120)
    assert fitted((480, 120), (160, 60)) == (80, 0, 320, 120)


def test_the_gaze_is_that_in_the_frame_that_is_shown(opened):
    # Black above and below.
    opened.answer(image=np.zeros((60, 160, 3), np.uint8))
    for point, gaze in (
        ((80, 90), Gaze(0.25, 0.25)),
        ((-20, 120), Gaze(0, 0.5)),
        ((160, 10), Gaze(0.5, 0)),
        ((400, 239), Gaze(1, 1)),
    ):
        assert opened.viewer.gaze_of(*point) == gaze


def test_events_have_the_time_that_the_shell_says(opened, clock):
    opened.answer()
    opened.viewer.handle({"type": "pointer_move", "x": 80, "y": 120}, 99.95)
    assert opened.asked().gaze_time == 99.95
    opened.answer()
    assert [seconds for _, seconds in opened.viewer.meter.latencies] == [pytest.approx(0.05)]


def test_an_error_of_the_renderer_closes_the_shell(opened):
    problem = ValueError("something is wrong")
    opened.viewer.on_failure(problem)
    assert opened.viewer.error is problem
    assert opened.closed


def test_a_frame_that_was_taken_already_is_not_shown_again(opened):
    opened.answer()
    opened.viewer.on_frame()
    assert len(opened.shown) == 1


@pytest.mark.parametrize(
    "event",
    [
        {},
        {"type": 3},
        {"type": []},
        {"type": "pointer_moved"},
        {"type": "pointer_move"},
        {"type": "pointer_move", "x": "1", "y": 2},
        {"type": "pointer_move", "x": True, "y": 2},
        {"type": "pointer_move", "x": float("nan"), "y": 2},
        {"type": "pointer_move", "x": 1, "y": 1e300},
        {"type": "pointer_down", "y": 2, "button": 1},
        {"type": "resize", "width": 0, "height": 0, "pwidth": 0, "pheight": 0},
        {"type": "resize", "width": 100, "height": 100, "pwidth": 1e6, "pheight": 100},
        {"type": "resize", "width": 100, "height": 100, "pwidth": 1, "pheight": 100},
        {"type": "key_down"},
        {"type": "key_up", "key": ["w"]},
        {"type": "control", "name": "samples"},
        {"type": "control", "name": "samples", "value": 1000},
        {"type": "control", "name": "samples", "value": True},
        {"type": "control", "name": "nothing", "value": 1},
        {"type": "control", "name": {}, "value": 1},
    ],
)
def test_events_that_make_no_sense_change_nothing(opened, event):
    before = opened.viewer.request, opened.viewer.pixels, dict(opened.viewer.controls.values)
    with pytest.raises(ValueError, match=r"\w"):
        opened.viewer.handle(event)
    opened.viewer.tick()
    assert (opened.viewer.request, opened.viewer.pixels, opened.viewer.controls.values) == before


def test_a_bench_begins_with_the_first_frame_of_the_final_size(make, clock):
    opened = make(bench=10.0)
    opened.load()
    opened.event("resize", width=300, height=200, pwidth=300, pheight=200)
    opened.answer()
    assert not opened.viewer.mouse_moves
    clock[0] = 107.0
    opened.viewer.tick()
    opened.answer()
    assert opened.viewer.mouse_moves
    # Four seconds of warm-up do not count.
    assert opened.viewer.bench.start == 111.0
    for clock[0] in (108.0, 120.9):
        opened.answer()
        opened.viewer.tick()
    assert opened.viewer.bench.start == 111.0
    assert not opened.closed
    clock[0] = 121.1
    opened.viewer.tick()
    assert opened.closed
    found, summary = opened.viewer.measured()
    assert [at for at, _ in found["frames"]] == pytest.approx([9.9])
    assert (found["width"], found["height"]) == (300, 200)
    assert "FPS" in summary


def test_a_bench_leaves_a_replayed_gaze_alone(make):
    opened = make(bench=10.0, trace=GazeTrace((0.0,), (HERE,)))
    opened.load()
    opened.answer()
    assert opened.viewer.bench.has_begun
    assert not opened.viewer.mouse_moves
