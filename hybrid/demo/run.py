"""Opens the window and runs it until it is closed."""

from __future__ import annotations

import signal
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QApplication

from compose.eye.gaze_trace import GazeTrace
from hybrid.demo.bench import WindowBench
from hybrid.demo.figures import figures, steadiness, summary
from hybrid.demo.thread import RenderThread
from hybrid.demo.window import Window
from hybrid.frame.settings import FrameSettings
from hybrid.interactive.gaze_input import GazeInput
from hybrid.interactive.prepare import prepared


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


def run_window(
    scene: str,
    forest: Path | None,
    backend: str,
    settings: FrameSettings,
    trace: GazeTrace | None,
    options: WindowOptions,
    thin_glass: bool = False,
) -> tuple[dict[str, Any], str]:
    """Runs the window until it is closed.

    Args:
        scene: name of a bundled scene, or a Mitsuba XML file.
        forest: forest file; None for the newest one of the scene.
        backend: auto, cuda or llvm.
        settings: initial settings of the frames.
        trace: replayed instead of the mouse; None for the mouse.
        options: how the window runs.
        thin_glass: whether panes of glass let shadow rays pass.

    Returns:
        What was measured (see `figures`; `target`, see `steadiness`), and a summary of it for people.

    Raises:
        UserError: the scene or the forest cannot be used.
    """
    application = QApplication(sys.argv[:1])
    measures = options.bench is not None
    # Training would take minutes of a measurement that is expected to take seconds.
    source = partial(prepared, scene, forest, backend, not measures, settings, thin_glass=thin_glass)
    thread = RenderThread(source)
    gaze = GazeInput(options.latency, trace)
    window = Window(
        thread, settings, options.target_fps, options.size, gaze, options.folder, measures, options.plays
    )
    bench = None
    if options.bench is not None:
        bench = WindowBench(window, options.bench, trace is None, options.load)
    window.show()
    # Qt does not notice Ctrl-C by itself.
    signal.signal(signal.SIGINT, lambda number, frame: window.close())
    application.exec()
    if window.error is not None:
        raise window.error
    size = window.canvas.width(), window.canvas.height()
    found = figures(window.meter, size, 0.0 if bench is None else bench.start)
    if options.target_fps is not None:
        loaded = None if bench is None else bench.loaded
        found["target"] = steadiness(found["frames"], options.target_fps, loaded)
    return found, summary(found)
