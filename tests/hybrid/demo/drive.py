"""Drives a real window as a person would, and writes down what it saw. Run as a program of its own."""

from __future__ import annotations

import json
import random
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from PySide6.QtCore import QEventLoop, QPoint, Qt, QTimer
from PySide6.QtGui import QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QSlider

from compose.eye.display import DISPLAYS
from compose.eye.gaze import Gaze
from hybrid.demo.thread import RenderThread
from hybrid.demo.window import Window
from hybrid.interactive.gaze_input import GazeInput
from hybrid.interactive.prepare import prepared
from hybrid.interactive.request import Settings, Shows
from hybrid.store import cache
from pathtrace.dataset.settings import CaptureSettings
from splat.io.forest_file import load_forest
from splat.training.trainer import TrainingSettings

SIZE = 320, 240
_PATIENCE = 120.0


def opened(forest: Path, folder: Path) -> Window:
    """A window that shows frames of the forest's scene, one of the bundled ones."""
    make = partial(prepared, load_forest(forest).scene_name, forest, DISPLAYS["desktop"], "auto", True)
    window = Window(RenderThread(make), Settings(), SIZE, GazeInput(0.0, None), folder)
    window.show()
    wait(lambda: window._last is not None and window._last.picture.shape[1] == SIZE[0])
    return window


def wait(done: Callable[[], bool]) -> None:
    """Until something is the case; the window lives on meanwhile."""
    end = time.monotonic() + _PATIENCE
    while not done():
        if time.monotonic() > end:
            raise TimeoutError
        pause(0.01)


def pause(seconds: float) -> None:
    loop = QEventLoop()
    QTimer.singleShot(round(1000 * seconds), loop.quit)
    loop.exec()


def picture(window: Window) -> np.ndarray:
    """(H, W, 3) what is on the screen where the frame is, once nothing older than now is shown there."""
    # The mouse is moved by the window system, when it comes to it.
    pause(0.1)
    wait(lambda: window._last is not None and window._last.request.same_picture(window._asked))
    grabbed = window.canvas.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(grabbed.constBits(), np.uint8).reshape(grabbed.height(), grabbed.bytesPerLine())
    return rows[:, : 3 * grabbed.width()].reshape(grabbed.height(), grabbed.width(), 3).copy()


def point(window: Window, gaze: Gaze) -> QPoint:
    return window.canvas.point_of(gaze).toPoint()


def disc(window: Window) -> dict[str, float]:
    """Where light is in a picture of the fovea alone, in pixels."""
    y, x = np.nonzero(picture(window).sum(axis=2) > 0)
    return {"x": (x.min() + x.max() + 1) / 2, "y": (y.min() + y.max() + 1) / 2, "width": int(np.ptp(x)) + 1}


def key(window: Window, which: Qt.Key) -> None:
    QTest.keyClick(window.canvas, which)


def trains(folder: Path, closes: float) -> dict[str, object]:
    """A forest that is missing is trained, the window alive; or closed before that is done."""
    cache.QUICK_CAPTURE = CaptureSettings(views=5, held_out=3, width=32, height=32, spp=2, held_out_spp=4)
    cache.QUICK_TRAINING = TrainingSettings(iterations=60, gaussians=400, degree=1, layers=2)
    make = partial(prepared, "cornell", None, DISPLAYS["desktop"], "auto", True)
    thread, said, beats = RenderThread(make), [], [time.monotonic()]
    thread.progress.connect(lambda what, done, total: said.append(what))
    window = Window(thread, Settings(), SIZE, GazeInput(0.0, None), folder)
    window.show()
    heart = QTimer()
    heart.timeout.connect(lambda: beats.append(time.monotonic()))
    heart.start(10)
    wait(lambda: window._last is not None or (closes > 0 and len(said) > 0))
    seen: dict[str, object] = {"said": sorted(set(said)), "pause": float(np.diff(beats).max())}
    return ended(window, seen | {"shown": window._last is not None})


def tour(forest: Path, folder: Path) -> dict[str, object]:
    """Mouse, keys and sliders, one after another."""
    window = opened(forest, folder)
    seen: dict[str, object] = {"platform": QApplication.platformName(), "first": picture(window).mean()}
    key(window, Qt.Key.Key_H)
    key(window, Qt.Key.Key_G)
    key(window, Qt.Key.Key_2)
    places = []
    for x, y in ((80, 60), (240, 180), (160, 120)):
        QTest.mouseMove(window.canvas, QPoint(x, y))
        places.append({"mouse": [x, y], **disc(window)})
    seen["discs"] = places
    assert window.panel is not None
    assert isinstance(window.panel.fov_a, QSlider)
    window.panel.fov_a.setValue(30)
    seen["wider"] = disc(window)["width"]
    key(window, Qt.Key.Key_Space)
    QTest.mouseMove(window.canvas, QPoint(40, 40))
    seen["held"] = disc(window)
    key(window, Qt.Key.Key_Space)
    seen["views"] = {}
    for number, shows in enumerate(Shows):
        key(window, Qt.Key(Qt.Key.Key_1 + number))
        seen["views"][shows.name] = picture(window).mean()  # type: ignore[index]
    key(window, Qt.Key.Key_1)
    seen["help"] = difference(window, lambda: key(window, Qt.Key.Key_F1))
    key(window, Qt.Key.Key_F1)
    seen["hud"] = difference(window, lambda: key(window, Qt.Key.Key_H))
    key(window, Qt.Key.Key_H)
    seen["walked"] = difference(window, lambda: hold(window, Qt.Key.Key_W))
    seen["dragged"] = difference(window, lambda: drag(window))
    before = window._asked
    key(window, Qt.Key.Key_R)
    picture(window)
    assert before is not None
    assert window._asked is not None
    seen["at home"] = window._asked.camera.position.tolist()
    seen["away"] = before.camera.position.tolist()
    key(window, Qt.Key.Key_T)
    for x in range(100, 220, 10):
        QTest.mouseMove(window.canvas, QPoint(x, 100))
        pause(0.02)
    key(window, Qt.Key.Key_T)
    key(window, Qt.Key.Key_P)
    wait(lambda: (folder / "cornell-001.exr").is_file())
    key(window, Qt.Key.Key_Tab)
    pause(0.3)
    seen["wide"] = window.canvas.width()
    picture(window)
    seen["frame"] = window._last.picture.shape if window._last else None
    return ended(window, seen)


def difference(window: Window, act: Callable[[], object]) -> float:
    """Mean over what has changed on the screen after something was done."""
    before = picture(window).astype(float)
    act()
    pause(0.2)
    return float(np.abs(picture(window) - before).mean())


def hold(window: Window, which: Qt.Key) -> None:
    QTest.keyPress(window.canvas, which)
    pause(0.4)
    QTest.keyRelease(window.canvas, which)


def drag(window: Window) -> None:
    button, canvas = Qt.MouseButton.LeftButton, window.canvas
    QTest.mousePress(canvas, button, Qt.KeyboardModifier.NoModifier, QPoint(100, 100))
    for x in range(100, 160, 10):
        QTest.mouseMove(canvas, QPoint(x, 100))
        pause(0.02)
    QTest.mouseRelease(canvas, button, Qt.KeyboardModifier.NoModifier, QPoint(150, 100))


def fuzz(forest: Path, folder: Path, seconds: float = 20.0) -> dict[str, object]:
    """Random input for a while, and how much memory that takes."""
    window, chance = opened(forest, folder), random.Random(7)
    start = time.monotonic()
    memory: list[tuple[float, float]] = []
    while (passed := time.monotonic() - start) < seconds:
        random_step(window, chance)
        if not memory or passed > memory[-1][0] + 1:
            memory.append((passed, resident()))
        pause(chance.choice((0.005, 0.01, 0.05, 0.2)))
    return ended(window, {"memory": memory})


def random_step(window: Window, chance: random.Random) -> None:
    """One thing that a person might do."""
    canvas, panel = window.canvas, window.panel
    assert panel is not None
    spot = QPoint(chance.randrange(-20, canvas.width() + 20), chance.randrange(-20, canvas.height() + 20))
    kind = chance.random()
    keys = "WASDQER1234567GHT" if chance.random() < 0.9 else "P"
    if kind < 0.6:
        QTest.mouseMove(canvas, spot)
    elif kind < 0.7:
        QTest.keyClick(canvas, Qt.Key(ord(chance.choice(keys))))
    elif kind < 0.75:
        QTest.keyPress(canvas, Qt.Key(ord(chance.choice("WASDQE"))))
        pause(chance.uniform(0, 0.3))
        for letter in "WASDQE":
            QTest.keyRelease(canvas, Qt.Key(ord(letter)))
    elif kind < 0.8:
        drag(window)
    elif kind < 0.9:
        slider = chance.choice(panel.findChildren(QSlider))
        # Radii and samples that a frame can be made of in a moment.
        most = min(slider.maximum(), 40 if slider in (panel.fov_a, panel.fov_b) else 100)
        slider.setValue(chance.randint(slider.minimum(), min(most, 4) if slider is panel.spp else most))
    elif kind < 0.93:
        panel.acuity_model.setCurrentIndex(chance.randrange(panel.acuity_model.count()))
    elif kind < 0.96:
        QTest.keyClick(canvas, chance.choice((Qt.Key.Key_Tab, Qt.Key.Key_F1, Qt.Key.Key_Space)))
    elif kind < 0.98:
        window.resize(chance.randrange(400, 700), chance.randrange(250, 450))
    else:
        panel.controlled.setChecked(not panel.controlled.isChecked())


def resident() -> float:
    """Memory of this process, in MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def ended(window: Window, seen: dict[str, object]) -> dict[str, object]:
    """After closing the window: what was seen, and what is left of it."""
    error = window.error
    window.close()
    threads = [thread.name for thread in threading.enumerate() if thread is not threading.main_thread()]
    # Qt's threads show up as dummies while they run Python.
    return seen | {"running": window._thread.isRunning(), "threads": threads, "error": error and str(error)}


if __name__ == "__main__":
    application = QApplication([])
    scenario, *files = sys.argv[1:4]
    arguments = [float(value) for value in sys.argv[4:]]
    paths = [Path(file) for file in files]
    scenarios = {"tour": tour, "fuzz": fuzz, "trains": lambda forest, out, closes: trains(out, closes)}
    result = scenarios[scenario](*paths, *arguments)
    (paths[1] / "seen.json").write_text(json.dumps(result, default=float))
