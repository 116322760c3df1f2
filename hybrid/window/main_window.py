"""The window: frames, controls, keys, and the gaze that goes to the renderer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from PySide6.QtCore import QSize, Qt, QTimer
from PySide6.QtGui import QCloseEvent, QKeyEvent
from PySide6.QtWidgets import QMainWindow, QProgressBar

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.canvas import Canvas
from hybrid.window.gaze_input import GazeInput, GazeRecording, unused_file
from hybrid.window.key_bindings import COMMANDS, HELP, Command, HeldKeys
from hybrid.window.messages import Ready, Request, ShownFrame, ShownView
from hybrid.window.meter import Meter, lines_of
from hybrid.window.navigation import Playback, Walker
from hybrid.window.panel import Panel, controls_dock
from hybrid.window.render_thread import RenderThread

# Milliseconds between two ticks: while keys or the gaze may change without an event, more often than any
# frame comes; otherwise rarely, since all the time that the window takes is lost to the renderer.
_TICK, _REST = 8, 100
# Milliseconds for which the window must keep its size until frames follow it; until then they are enlarged.
# With a target, each new size is measured for half a minute.
_SETTLE = 200
# Milliseconds for which a message stays.
_MESSAGE = 5000


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


class MainWindow(QMainWindow):
    """Shows one scene, which a thread that is not started yet renders; a bench keeps the times of all frames.

    Attributes:
        panel, walker: controls and viewer; None until the scene is loaded.
        request: the newest one that was sent to the renderer.
        shown: the frame on the screen.
        error: that ended the renderer.
    """

    def __init__(
        self, thread: RenderThread, settings: FrameSettings, gaze: GazeInput, options: WindowOptions
    ):
        super().__init__()
        self._thread, self._settings, self._gaze, self._options = thread, settings, gaze, options
        self._size = options.size
        self.canvas, self.meter = Canvas(QSize(*options.size)), Meter(keeps_all=options.bench is not None)
        self.panel: Panel | None = None
        self.walker: Walker | None = None
        self.request: Request | None = None
        self.shown: ShownFrame | None = None
        self.error: Exception | None = None
        self._ready: Ready | None = None
        self._playback: Playback | None = None
        self._held_gaze: Gaze | None = None
        self._held_keys = HeldKeys(time.perf_counter())
        self._recording = GazeRecording(options.folder)
        self._texts = {Command.HUD}
        self._actions: dict[Command | ShownView, Callable[[], object]] = {
            Command.HOLD: self._toggle_hold,
            Command.RING: self.canvas.toggle_ring,
            **{text: partial(self._toggle_text, text) for text in (Command.HUD, Command.HELP)},
            Command.FULL_SCREEN: self._toggle_full_screen,
            Command.LEAVE: self._leave,
        }
        self.setWindowTitle("hybrid")
        self.setCentralWidget(self.canvas)
        self._bar = bar = QProgressBar()
        bar.setFormat("loading the scene")
        bar.setMaximum(0)
        self.statusBar().addPermanentWidget(bar, 1)
        # Hiding the bar must not change the size of the frame.
        self.statusBar().setFixedHeight(bar.sizeHint().height())
        self._settling = QTimer(self, interval=_SETTLE, singleShot=True)
        self._timer = QTimer(self, interval=_REST)
        thread.progress.connect(self._on_progress)
        thread.ready.connect(self._on_ready)
        thread.arrived.connect(self._on_frame)
        thread.saved.connect(self._say)
        thread.failed.connect(self._on_failure)
        self.canvas.gazed.connect(self._on_gaze)
        self.canvas.dragged.connect(self._on_drag)
        self.canvas.painted.connect(self._on_painted)
        self.canvas.resized.connect(self._settling.start)
        self._settling.timeout.connect(self._on_settled)
        self._timer.timeout.connect(self.tick)
        self._timer.start()
        thread.start()

    def tick(self) -> None:
        """Walks as far as keys are held, and asks for the frame that this and the gaze call for."""
        now = time.perf_counter()
        seconds = self._held_keys.elapsed(now)
        plays = self._playback is not None and self._playback.playing
        interval = _TICK if self._held_keys or self._gaze.changes_by_itself or plays else _REST
        if self._timer.interval() != interval:
            self._timer.setInterval(interval)
        if self._ready is None or self.walker is None or self.panel is None:
            return
        self._held_keys.move(self.walker, self._ready.distance, seconds)
        before, newest = self._gaze.last, self._gaze.at(now)
        gaze = self._held_gaze or newest.gaze
        self._recording.add(now, gaze)
        settings = replace(self.panel.settings(), camera=self.walker.camera(*self._size), gaze=gaze)
        if self._playback is not None:
            settings = replace(settings, time=self._playback.at(now))
            self.panel.show_time(settings.time)
        request = Request(settings, self.panel.view, newest.time, self.panel.target_fps)
        if request.same_frame(self.request):
            return
        # A gaze that is held or released has not moved.
        if self.request is not None and gaze != self.request.settings.gaze and newest.time != before.time:
            self.meter.moved(newest.time)
        self.request = request
        self._thread.requests.put(request)

    def closeEvent(self, event: QCloseEvent) -> None:  # noqa: N802
        self._timer.stop()
        self._thread.stop()
        event.accept()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        if self._held_keys.press(event.key(), time.perf_counter()):
            self.tick()
        elif not event.isAutoRepeat():
            command = COMMANDS.get(event.key())
            action = self._actions.get(command) if command else None
            if action is not None:
                action()
            self._write()
            self.tick()

    def keyReleaseEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        if not event.isAutoRepeat():
            self._held_keys.discard(event.key())

    def focusNextPrevChild(self, forward: bool) -> bool:  # noqa: N802
        # Tab is a command here.
        return False

    def changeEvent(self, event: object) -> None:  # noqa: N802
        # When another window comes to the front, it gets the releases of held keys.
        if not self.isActiveWindow():
            self._held_keys.clear()

    def _on_ready(self, ready: Ready) -> None:
        self._ready = ready
        self.setWindowTitle(f"{ready.name} - hybrid")
        self.walker = Walker(ready.camera)
        self._playback = None if ready.seconds is None else Playback(ready.seconds)
        self.panel = panel = Panel(self._settings, self._options.target_fps, ready.layers, self._playback)
        panel.changed.connect(self.tick)
        dock = controls_dock(panel)
        self.addDockWidget(Qt.DockWidgetArea.RightDockWidgetArea, dock)
        self._actions |= {
            Command.HOME: self.walker.reset,
            Command.SAVE: partial(self._save, ready.name),
            Command.RECORD: lambda: self._say(self._recording.toggle(ready.name)),
            Command.CONTROLS: lambda: dock.setVisible(not dock.isVisible()),
        }
        if panel.play is not None:
            self._actions[Command.PLAY] = panel.play.toggle
            panel.play.setChecked(self._options.plays)
        self._actions |= {view: partial(panel.views.setCurrentIndex, n) for n, view in enumerate(ShownView)}
        self._bar.hide()
        # As large as the frame needs it beside the controls, once Qt has laid those out.
        QTimer.singleShot(0, lambda: self.resize(self.size() + self.canvas.sizeHint() - self.canvas.size()))
        self.canvas.setFocus()
        self._say("F1: help")
        self.tick()

    def _on_settled(self) -> None:
        self._size = self.canvas.pixels
        self.tick()

    def _on_progress(self, activity: str, done: int, total: int) -> None:
        self.meter.pause()
        self._bar.setVisible(done < total)
        self._bar.setMaximum(total)
        self._bar.setValue(done)
        self._bar.setFormat(f"{activity} %v / %m")

    def _on_gaze(self, gaze: Gaze) -> None:
        self._gaze.move(time.perf_counter(), gaze)
        self.tick()

    def _on_drag(self, right: float, down: float) -> None:
        if self.walker is not None and self._ready is not None:
            # The scene follows the hand.
            degrees = self._ready.camera.vertical_fov
            self.walker.look(-right * degrees, -down * degrees)

    def _on_frame(self) -> None:
        shown = self._thread.frames.take()
        if shown is not None:
            self.canvas.show_frame(shown)

    def _on_painted(self, shown: ShownFrame) -> None:
        self.meter.shown(time.perf_counter(), shown.request.gaze_time, shown.milliseconds)
        self.shown = shown
        self._write()

    def _on_failure(self, error: Exception) -> None:
        self.error = error
        self.close()

    def _save(self, name: str) -> None:
        try:
            self._thread.save(unused_file(self._options.folder, name, ".png"))
        except UserError as error:
            self._say(str(error))

    def _toggle_hold(self) -> None:
        self._held_gaze = None if self._held_gaze else self._gaze.at(time.perf_counter()).gaze

    def _toggle_text(self, text: Command) -> None:
        self._texts ^= {text}

    def _toggle_full_screen(self) -> None:
        self.showNormal() if self.isFullScreen() else self.showFullScreen()

    def _leave(self) -> None:
        self.showNormal() if self.isFullScreen() else self.close()

    def _say(self, text: str) -> None:
        self.statusBar().showMessage(text, _MESSAGE)

    def _write(self) -> None:
        hud = lines_of(self.shown, self.meter) if Command.HUD in self._texts and self.shown else []
        self.canvas.write(hud, HELP if Command.HELP in self._texts else [])
