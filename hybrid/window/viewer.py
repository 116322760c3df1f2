"""The window without a toolkit: events become the viewer's state and requests, frames become what is shown.

A shell (of Qt, in a browser, in a notebook) hands plain events to a viewer, shows what it has to show, and
says when a frame is on the screen. All of it lives on one thread, the shell's.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from compose.base.errors import UserError
from compose.eye.gaze import Gaze, GazeTrace
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.controls import Controls, Playback
from hybrid.window.frame_source import prepared
from hybrid.window.gaze_input import GazeInput, GazeRecording, unused_file
from hybrid.window.key_bindings import COMMANDS, HELP, Command, HeldKeys, Walker
from hybrid.window.learning import ShownScene
from hybrid.window.messages import Ready, Request, ShownFrame, ShownView
from hybrid.window.meter import Meter, WindowBench, figures, lines_of, steadiness, summary
from hybrid.window.render_thread import Post, RenderThread

# Seconds between two ticks: while something may change without an event, more often than any frame comes;
# otherwise rarely, since all the time that the shell takes is lost to the renderer.
_TICK, _REST = 0.008, 0.1
# Seconds for which a window must keep its size until frames follow it; until then they are enlarged. With a
# target, each new size is measured for half a minute.
_SETTLE = 0.2
# Seconds for which a message stays, and from one change of the frame times that are shown to the next: laying
# out text that nobody can read takes a browser a millisecond of each frame.
_MESSAGE, _READ = 5.0, 0.25
# Ends of the width and height of a canvas in pixels.
_LEAST_SIDE, _MOST_SIDE = 16, 8192

# What happens to a window, with "type" and what belongs to it; the names are those of rendercanvas. Points
# and widths are in the shell's own units, in which a canvas has `width` and `height`.
#   resize        width, height, pwidth, pheight (in pixels of the screen)
#   pointer_move  x, y
#   pointer_down, pointer_up   x, y, button (1: left)
#   key_down      key (see key_bindings), repeat (optional: whether it was down already)
#   key_up        key
#   blur          the window gets no keys any more
#   control       name, value (see Controls)
Event = Mapping[str, object]


@dataclass(frozen=True)
class WindowOptions:
    """How the window runs.

    Attributes:
        size: width and height of the frame in pixels.
        latency: delay of the gaze in seconds.
        folder: for screenshots and gaze traces.
        target_fps: frames per second to keep; None for no target.
        bench: seconds after which the window closes, with the mouse moving until then; None leaves it open.
        load: seconds of the bench for which another process keeps one core busy.
        plays: whether a scene that moves plays from the start.
    """

    size: tuple[int, int]
    latency: float
    folder: Path
    target_fps: float | None = None
    bench: float | None = None
    load: float = 0.0
    plays: bool = False


class Shell(Protocol):
    """Shows what a viewer has to show."""

    def show_frame(self, shown: ShownFrame) -> None:
        """Shows a frame; tells the viewer once it is `painted`."""

    def refresh(self) -> None:
        """Shows texts, progress and controls as they are now."""

    def close(self) -> None:
        """Ends; closes the viewer."""


def fitted(canvas: tuple[float, float], image: tuple[int, int]) -> tuple[float, float, float, float]:
    """Left, top, width and height of an image in its own proportions, as large as a canvas has room for."""
    scale = min(canvas[0] / image[0], canvas[1] / image[1])
    width, height = scale * image[0], scale * image[1]
    return (canvas[0] - width) / 2, (canvas[1] - height) / 2, width, height


class Viewer:
    """Looks at one scene, which a thread that is not started yet renders.

    Attributes:
        trace: replaces the mouse; None if the mouse is the gaze.
        controls, walker: None until the scene is loaded.
        request: the newest one that was sent to the renderer.
        shown: the frame on the screen.
        pixels: width and height of the canvas in pixels of the screen.
        progress: activity, steps done, and in total (0: unknown); None if there is none.
        status: a text of the renderer that holds until another one replaces it.
        error: that ended the renderer.
    """

    def __init__(
        self, thread: RenderThread, settings: FrameSettings, trace: GazeTrace | None, options: WindowOptions
    ):
        self.thread, self.options, self.trace = thread, options, trace
        self._settings, self._gaze = settings, GazeInput(options.latency, trace)
        self.bench = None if options.bench is None else WindowBench(options.bench, options.load)
        self.meter = Meter(keeps_all=options.bench is not None)
        self.controls: Controls | None = None
        self.walker: Walker | None = None
        self.request: Request | None = None
        self.shown: ShownFrame | None = None
        self.error: Exception | None = None
        self.title = "hybrid"
        self.progress: tuple[str, int, int] | None = ("loading the scene", 0, 0)
        self.status = ""
        self.pixels = self._size = options.size
        self._canvas = float(options.size[0]), float(options.size[1])
        # When frames follow the canvas's size.
        self._settles = math.inf
        # Width and height of the newest frame.
        self._image = options.size
        self._ready: Ready | None = None
        self._playback: Playback | None = None
        self._held_gaze: Gaze | None = None
        self._held_keys = HeldKeys(time.perf_counter())
        # Where the mouse was when it last moved with its left button down.
        self._held_point: tuple[float, float] | None = None
        self._recording = GazeRecording(options.folder)
        self._said, self._said_until = "", 0.0
        # Lines of frame times, of which frame, and since when.
        self._lines: list[str] = []
        self._told: ShownFrame | None = None
        self._told_at = -math.inf
        self._visible = {Command.HUD, Command.RING, Command.CONTROLS}
        self._actions: dict[Command | ShownView, Callable[[], object]] = {
            Command.HOLD: self._toggle_hold,
            **{one: partial(self._toggle, one) for one in (*self._visible, Command.HELP)},
        }
        self._events: dict[object, Callable[[Event, float | None], None]] = {
            "resize": self._on_resize,
            "pointer_move": self._on_pointer,
            "pointer_down": self._on_button,
            "pointer_up": self._on_button,
            "key_down": self._on_key_down,
            "key_up": lambda event, at: self._held_keys.discard(_key(event)),
            "blur": lambda event, at: self._release(),
            "control": self._on_control,
        }

    def open(self, shell: Shell, post: Post) -> None:
        """Starts the renderer; `post` has functions called soon on this thread, and may be used on any."""
        self._shell = shell
        self.thread.start(self, post)

    def close(self) -> None:
        """Ends the renderer after the frame or step that it is at."""
        self.thread.stop()

    def handle(self, event: Event, at: float | None = None) -> None:
        """Takes an event (see `Event`) that happened at a time.perf_counter, by default now.

        ValueError if there is no such event, or if a part of it is missing or has a senseless value; nothing
        is changed then.
        """
        kind = event.get("type")
        action = self._events.get(kind) if isinstance(kind, str) else None
        if action is None:
            raise ValueError(f"event {kind!r}: unknown")
        action(event, at)
        self.tick()

    def tick(self) -> None:
        """Walks as far as keys are held, and asks for the frame that this and the gaze call for."""
        now = time.perf_counter()
        seconds = self._held_keys.elapsed(now)
        if self._said and now >= self._said_until:
            self.say("")
        if self._tells(now):
            self._shell.refresh()
        if now >= self._settles:
            self._settles, self._size = math.inf, self.pixels
        if self.bench is not None and self.bench.is_over(now):
            self._shell.close()
            return
        if self._ready is None or self.walker is None or self.controls is None:
            return
        self._held_keys.move(self.walker, self._ready.distance, seconds)
        before, newest = self._gaze.last, self._gaze.at(now)
        gaze = self._held_gaze or newest.gaze
        self._recording.add(now, gaze)
        settings = replace(self.controls.settings(), camera=self.walker.camera(*self._size), gaze=gaze)
        if self._playback is not None:
            settings = replace(settings, time=self._playback.at(now))
            self.controls.show_time(settings.time)
        request = Request(settings, self.controls.view, newest.time, self.controls.target_fps)
        if request.same_frame(self.request):
            return
        # A gaze that is held or released has not moved.
        if self.request is not None and gaze != self.request.settings.gaze and newest.time != before.time:
            self.meter.moved(newest.time)
        self.request = request
        self.thread.requests.put(request)

    @property
    def interval(self) -> float:
        """Seconds after which the shell should call `tick`, unless an event comes before."""
        plays = self._playback is not None and self._playback.playing
        changes = self._held_keys or self._gaze.changes_by_itself or plays or self._settles < math.inf
        return _TICK if changes or (self.bench is not None and self.bench.has_begun) else _REST

    def painted(self, shown: ShownFrame, at: float) -> None:
        """Notes that a frame is on the screen since a time.perf_counter."""
        self.meter.shown(at, shown.request.gaze_time, shown.milliseconds)
        self.shown = shown
        camera = shown.request.settings.camera
        # Before it has the window's size, the window has just been laid out; better frames come next. And not
        # before the first frame: a forest may be trained, or settings measured.
        is_final = camera is not None and (camera.width, camera.height) == self.pixels
        if self.bench is not None and not self.bench.has_begun and is_final:
            self.bench.begin(time.perf_counter())
        self._tells(time.perf_counter())
        self._shell.refresh()

    def _tells(self, now: float) -> bool:
        """Whether the frame times that are shown are others from now on."""
        if self.shown is self._told or now - self._told_at < _READ or self.shown is None:
            return False
        self._told, self._told_at = self.shown, now
        self._lines = lines_of(self.shown, self.meter)
        return True

    @property
    def mouse_moves(self) -> bool:
        """Whether the shell should move the mouse as the bench wants it."""
        return self.bench is not None and self.bench.has_begun and self.trace is None

    def shows(self, what: Command) -> bool:
        """Whether ring, frame times, controls or help are to be seen."""
        return what in self._visible

    @property
    def hud(self) -> list[str]:
        """Lines in the upper left corner."""
        return self._lines if self.shows(Command.HUD) else []

    @property
    def overlay(self) -> list[str]:
        """Lines in the middle."""
        return HELP if self.shows(Command.HELP) else []

    @property
    def line(self) -> str:
        """The line below the frame: the newest message or, after some seconds, the status."""
        return self._said or self.status

    def gaze_of(self, x: float, y: float) -> Gaze:
        """The gaze at a point of the canvas; outside the frame, the nearest one on its edge."""
        left, top, width, height = fitted(self._canvas, self._image)
        return Gaze(min(max((x - left) / width, 0.0), 1.0), min(max((y - top) / height, 0.0), 1.0))

    def measured(self) -> tuple[dict[str, Any], str]:
        """What was measured (see `figures`; `target`, see `steadiness`), and a summary of it for people."""
        found = figures(self.meter, self.pixels, 0.0 if self.bench is None else self.bench.start)
        if self.options.target_fps is not None:
            loaded = None if self.bench is None else self.bench.loaded
            found["target"] = steadiness(found["frames"], self.options.target_fps, loaded)
        return found, summary(found)

    def on_ready(self, ready: Ready) -> None:
        self._ready, self.title, self.progress = ready, f"{ready.name} - hybrid", None
        self.walker = walker = Walker(ready.camera)
        self._actions |= {
            Command.HOME: walker.reset,
            Command.SAVE: partial(self._save, ready.name),
            Command.RECORD: lambda: self.say(self._recording.toggle(ready.name)),
        }
        if ready.seconds is not None:
            self._playback = Playback(ready.seconds)
            self._playback.playing = self.options.plays
        self.controls = controls = Controls(
            self._settings, self.options.target_fps, ready.layers, self._playback
        )
        if self._playback is not None:
            self._actions[Command.PLAY] = lambda: controls.set("play", 1 - controls.values["play"])
        self._actions |= {view: partial(controls.set, "view", n) for n, view in enumerate(ShownView)}
        self.say("F1: help")
        self.tick()

    def on_layers(self, layers: int) -> None:
        if self.controls is not None:
            self.controls.set_layers(layers)
        self._shell.refresh()

    def on_progress(self, activity: str, done: int, total: int) -> None:
        self.meter.pause()
        self.progress = (activity, done, total) if done < total else None
        self._shell.refresh()

    def on_frame(self) -> None:
        shown = self.thread.frames.take()
        if shown is not None:
            height, width = shown.image.shape[:2]
            self._image = width, height
            self._shell.show_frame(shown)

    def on_status(self, text: str) -> None:
        self.status = text
        self._shell.refresh()

    def say(self, text: str) -> None:
        """Shows a message for some seconds."""
        self._said, self._said_until = text, time.perf_counter() + _MESSAGE
        self._shell.refresh()

    def on_failure(self, error: Exception) -> None:
        self.error = error
        self._shell.close()

    def _on_resize(self, event: Event, at: float | None) -> None:
        canvas = _number(event, "width", 1), _number(event, "height", 1)
        width, height = (_number(event, name, _LEAST_SIDE, _MOST_SIDE) for name in ("pwidth", "pheight"))
        self._canvas, self.pixels = canvas, (round(width), round(height))
        self._settles = time.perf_counter() + _SETTLE if self.pixels != self._size else math.inf

    def _on_pointer(self, event: Event, at: float | None) -> None:
        x, y = _number(event, "x"), _number(event, "y")
        if self._held_point is not None:
            (before_x, before_y), self._held_point = self._held_point, (x, y)
            if self.walker is not None and self._ready is not None:
                # The scene follows the hand.
                degrees = self._ready.camera.vertical_fov / self._canvas[1]
                self.walker.look((before_x - x) * degrees, (before_y - y) * degrees)
        self._gaze.move(time.perf_counter() if at is None else at, self.gaze_of(x, y))

    def _on_button(self, event: Event, at: float | None) -> None:
        point = _number(event, "x"), _number(event, "y")
        if event.get("button") == 1:
            self._held_point = point if event["type"] == "pointer_down" else None

    def _on_key_down(self, event: Event, at: float | None) -> None:
        key = _key(event)
        if self._held_keys.press(key, time.perf_counter()) or event.get("repeat"):
            return
        command = COMMANDS.get(key)
        action = self._actions.get(command) if command else None
        if action is not None:
            action()
            self._shell.refresh()

    def _on_control(self, event: Event, at: float | None) -> None:
        name, value = event.get("name"), event.get("value")
        if self.controls is None or not isinstance(name, str) or not isinstance(value, int):
            raise ValueError(f"control {name!r}: cannot be {value!r}")
        self.controls.set(name, value)
        self._shell.refresh()

    def _release(self) -> None:
        self._held_keys.clear()
        self._held_point = None

    def _save(self, name: str) -> None:
        try:
            self.thread.save(unused_file(self.options.folder, name, ".png"))
        except UserError as error:
            self.say(str(error))

    def _toggle_hold(self) -> None:
        self._held_gaze = None if self._held_gaze else self._gaze.at(time.perf_counter()).gaze

    def _toggle(self, what: Command) -> None:
        self._visible ^= {what}


def viewer_of(
    scene: ShownScene,
    forest: Path | None,
    settings: FrameSettings,
    trace: GazeTrace | None,
    options: WindowOptions,
    learns: bool = True,
) -> Viewer:
    """A viewer of a scene (see `prepared`); the trace is replayed instead of the mouse."""
    thread = RenderThread(lambda report: prepared(scene, forest, learns, settings, report, thread.tell))
    return Viewer(thread, settings, trace, options)


def _number(event: Event, name: str, least: float = -1e6, most: float = 1e6) -> float:
    """A finite number of an event; ValueError if it is none or out of range."""
    value = event.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise ValueError(f"{event['type']}: {name} {value!r} is not a number from {least:g} to {most:g}")
    return float(value)


def _key(event: Event) -> str:
    key = event.get("key")
    if not isinstance(key, str):
        raise ValueError(f"{event['type']}: key {key!r} is no text")
    return key.lower() if len(key) == 1 else key
