"""Drives a real window as a person would, and writes down what it saw. Run as a program of its own."""

from __future__ import annotations

import json
import random
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PySide6.QtCore import QEventLoop, QPoint, Qt, QTimer
from PySide6.QtGui import QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QSlider

from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.main_window import MainWindow
from hybrid.window.messages import ShownView
from hybrid.window.viewer import WindowOptions, viewer_of
from splat.io.forest_file import load_forest
from tests.hybrid.preparation.tiny import make_tiny
from tests.small import resident_memory

SIZE = 320, 240
_PATIENCE = 120.0


def opened(forest: Path, folder: Path) -> MainWindow:
    """A window that shows frames of the forest's scene, one of the bundled ones."""
    window = window_of(load_forest(forest).scene_name, forest, folder)
    window.show()
    wait(lambda: window.viewer.shown is not None and window.viewer.shown.image.shape[1] == SIZE[0])
    return window


def window_of(scene: str, forest: Path | None, folder: Path) -> MainWindow:
    return MainWindow(viewer_of(scene, forest, "auto", INTERACTIVE, None, WindowOptions(SIZE, 0.0, folder)))


def wait(done: Callable[[], bool]) -> None:
    """Waits until something is the case, while the window runs."""
    end = time.monotonic() + _PATIENCE
    while not done():
        if time.monotonic() > end:
            raise TimeoutError
        pause(0.01)


def pause(seconds: float) -> None:
    """Lets the window run for a while."""
    loop = QEventLoop()
    QTimer.singleShot(round(1000 * seconds), loop.quit)
    loop.exec()


def image(window: MainWindow) -> np.ndarray:
    """(H, W, 3) what is on the screen where the frame is, once it answers all input until now."""
    # The window system moves the mouse some time later.
    pause(0.1)
    wait(
        lambda: (
            window.viewer.shown is not None and window.viewer.shown.request.same_frame(window.viewer.request)
        )
    )
    grabbed = window.canvas.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(grabbed.constBits(), np.uint8).reshape(grabbed.height(), grabbed.bytesPerLine())
    return rows[:, : 3 * grabbed.width()].reshape(grabbed.height(), grabbed.width(), 3).copy()


def disc(window: MainWindow) -> dict[str, float]:
    """Where there is light in the view of the fovea alone, in pixels."""
    y, x = np.nonzero(image(window).sum(axis=2) > 0)
    return {"x": (x.min() + x.max() + 1) / 2, "y": (y.min() + y.max() + 1) / 2, "width": int(np.ptp(x)) + 1}


def key(window: MainWindow, which: Qt.Key) -> None:
    QTest.keyClick(window.canvas, which)


def trains(folder: Path, closes: float) -> dict[str, object]:
    """Trains a missing forest while the window stays responsive; or closes the window before that is done."""
    make_tiny(setattr)
    window, said, beats = window_of("cornell", None, folder), [], [time.monotonic()]
    window.viewer.on_progress = lambda activity, done, total: said.append(activity)  # type: ignore[method-assign]
    window.show()
    heart = QTimer()
    heart.timeout.connect(lambda: beats.append(time.monotonic()))
    heart.start(10)
    wait(lambda: window.viewer.shown is not None or (closes > 0 and len(said) > 0))
    pauses = np.diff(beats)
    wait(lambda: closes > 0 or window.viewer.status != "")
    seen: dict[str, object] = {"said": sorted(set(said)), "pause": float(pauses.max()), "status": window.viewer.status}
    return ended(window, seen | {"shown": window.viewer.shown is not None})


def tour(forest: Path, folder: Path) -> dict[str, object]:
    """Uses mouse, keys and sliders, one after another."""
    window = opened(forest, folder)
    seen: dict[str, object] = {"platform": QApplication.platformName(), "first": image(window).mean()}
    # Neither text nor ring; the fovea alone.
    for which in (Qt.Key.Key_H, Qt.Key.Key_G, Qt.Key.Key_2):
        key(window, which)
    seen |= discs(window)
    seen["views"] = {}
    for number, view in enumerate(ShownView):
        key(window, Qt.Key(Qt.Key.Key_1 + number))
        seen["views"][view.name] = image(window).mean()  # type: ignore[index]
    key(window, Qt.Key.Key_1)
    seen["help"] = difference(window, lambda: key(window, Qt.Key.Key_F1))
    key(window, Qt.Key.Key_F1)
    seen["hud"] = difference(window, lambda: key(window, Qt.Key.Key_H))
    key(window, Qt.Key.Key_H)
    seen |= walk(window)
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
    image(window)
    seen["frame"] = window.viewer.shown.image.shape if window.viewer.shown else None
    return ended(window, seen)


def discs(window: MainWindow) -> dict[str, object]:
    """Where the disc is while the mouse moves, with a larger radius, and while the gaze is held."""
    found = []
    for x, y in ((80, 60), (240, 180), (160, 120)):
        QTest.mouseMove(window.canvas, QPoint(x, y))
        found.append({"mouse": [x, y], **disc(window)})
    assert window.panel is not None
    window.panel.widgets["fov-a"].setValue(30)
    wider = disc(window)["width"]
    key(window, Qt.Key.Key_Space)
    QTest.mouseMove(window.canvas, QPoint(40, 40))
    held = disc(window)
    key(window, Qt.Key.Key_Space)
    return {"discs": found, "wider": wider, "held": held}


def walk(window: MainWindow) -> dict[str, object]:
    """How much of the image walking and dragging change, and where the viewer is then, and back at home."""
    walked = difference(window, lambda: hold(window, Qt.Key.Key_W))
    dragged = difference(window, lambda: drag(window))
    away = position(window)
    key(window, Qt.Key.Key_R)
    image(window)
    return {"walked": walked, "dragged": dragged, "away": away, "at home": position(window)}


def position(window: MainWindow) -> list[float]:
    """Where the camera of the newest request is."""
    assert window.viewer.request is not None
    assert window.viewer.request.settings.camera is not None
    return window.viewer.request.settings.camera.position.tolist()


def difference(window: MainWindow, act: Callable[[], object]) -> float:
    """Mean absolute change of the image after something was done."""
    before = image(window).astype(float)
    act()
    pause(0.2)
    return float(np.abs(image(window) - before).mean())


def hold(window: MainWindow, which: Qt.Key) -> None:
    """Holds a key for a while."""
    QTest.keyPress(window.canvas, which)
    pause(0.4)
    QTest.keyRelease(window.canvas, which)


def drag(window: MainWindow) -> None:
    """Drags the scene to the right."""
    button, canvas = Qt.MouseButton.LeftButton, window.canvas
    QTest.mousePress(canvas, button, Qt.KeyboardModifier.NoModifier, QPoint(100, 100))
    for x in range(100, 160, 10):
        QTest.mouseMove(canvas, QPoint(x, 100))
        pause(0.02)
    QTest.mouseRelease(canvas, button, Qt.KeyboardModifier.NoModifier, QPoint(150, 100))


def fuzz(forest: Path, folder: Path, seconds: float = 20.0) -> dict[str, object]:
    """Random input for some seconds; records the memory in MiB, second by second."""
    window, chance = opened(forest, folder), random.Random(7)
    start = time.monotonic()
    memory: list[tuple[float, float]] = []
    while (passed := time.monotonic() - start) < seconds:
        random_step(window, chance)
        if not memory or passed > memory[-1][0] + 1:
            memory.append((passed, resident_memory() / 2**20))
        pause(chance.choice((0.005, 0.01, 0.05, 0.2)))
    return ended(window, {"memory": memory})


def random_step(window: MainWindow, chance: random.Random) -> None:
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
        name, slider = chance.choice([(n, w) for n, w in panel.widgets.items() if isinstance(w, QSlider)])
        # Radii and samples with which frames stay quick.
        most = min(slider.maximum(), 40 if name in ("fov-a", "fov-b") else 100)
        slider.setValue(chance.randint(slider.minimum(), min(most, 4) if name == "samples" else most))
    elif kind < 0.93:
        models = panel.widgets["acuity model"]
        models.setCurrentIndex(chance.randrange(models.count()))
    elif kind < 0.96:
        QTest.keyClick(canvas, chance.choice((Qt.Key.Key_Tab, Qt.Key.Key_F1, Qt.Key.Key_Space)))
    elif kind < 0.98:
        window.resize(chance.randrange(400, 700), chance.randrange(250, 450))
    else:
        panel.widgets["keep FPS"].toggle()


def ended(window: MainWindow, seen: dict[str, object]) -> dict[str, object]:
    """Closes the window, and adds to what was seen what is left running."""
    error = window.viewer.error
    window.close()
    threads = [thread.name for thread in threading.enumerate() if thread is not threading.main_thread()]
    # Qt's threads are listed as dummies while they run Python.
    return seen | {"running": window.viewer.thread.running, "threads": threads, "error": error and str(error)}


if __name__ == "__main__":
    application = QApplication([])
    scenario, *files = sys.argv[1:4]
    arguments = [float(value) for value in sys.argv[4:]]
    paths = [Path(file) for file in files]
    scenarios = {"tour": tour, "fuzz": fuzz, "trains": lambda forest, folder, closes: trains(folder, closes)}
    result = scenarios[scenario](*paths, *arguments)
    (paths[1] / "seen.json").write_text(json.dumps(result, default=float))
