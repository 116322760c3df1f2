"""The frame on the canvas: where it is, what is drawn, and where the mouse is on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)

from PySide6.QtCore import QEvent, QObject, QPointF, QSize, Qt
from PySide6.QtGui import QImage, QMouseEvent
from PySide6.QtWidgets import QApplication

from compose.eye.gaze import Gaze
from hybrid.window.canvas import Canvas
from tests.hybrid.window.fakes import shown


@pytest.fixture
def canvas(application) -> Any:
    """320 by 240 pixels, with a frame of 160 by 60: there are 60 rows of black above and below it."""
    canvas = Canvas(QSize(320, 240))
    canvas.resize(320, 240)
    rows = np.zeros((60, 160, 3), dtype=np.uint8)
    rows[:, :80] = [200, 100, 50]
    rows[:, 80:] = [10, 20, 30]
    canvas.show_frame(shown(image=rows))
    return canvas


def pixels(canvas: Canvas) -> np.ndarray:
    """(H, W, 3) what the canvas shows."""
    image = canvas.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).copy()


def events(canvas: Canvas) -> list[dict[str, object]]:
    """What the canvas reports from now on."""
    found: list[dict[str, object]] = []
    canvas.happened.connect(found.append)
    return found


def mouse(canvas: Canvas, kind: QEvent.Type, x: float, y: float, button: Qt.MouseButton) -> None:
    point = QPointF(x, y)
    none = Qt.KeyboardModifier.NoModifier
    QApplication.sendEvent(canvas, QMouseEvent(kind, point, point, button, button, none))


@pytest.mark.parametrize("ratio", [1.0, 1.5, 2.0])
def test_a_new_size_is_reported_in_the_pixels_of_a_scaled_screen(canvas, monkeypatch, ratio):
    """Eccentricities are of those: at half of them, they would be half as large."""
    monkeypatch.setattr(Canvas, "devicePixelRatioF", lambda self: ratio)
    assert canvas.sizeHint() == QSize(320, 240) / ratio
    happened = events(canvas)
    canvas.resize(200, 160)
    # Qt tells a widget that is hidden no sooner than it is shown.
    canvas.grab()
    pixels = {"pwidth": round(200 * ratio), "pheight": round(160 * ratio)}
    assert happened[-1] == {"type": "resize", "width": 200, "height": 160, **pixels}


def test_before_the_first_frame_it_is_black_and_nothing_is_reported(application):
    canvas, painted = Canvas(QSize(320, 240)), []
    canvas.painted.connect(painted.append)
    assert not pixels(canvas).any()
    assert not painted


def test_it_takes_the_keys_and_stays_large_enough_to_look_at(canvas):
    assert canvas.focusPolicy() == Qt.FocusPolicy.StrongFocus
    assert canvas.minimumSize() == QSize(160, 120)
    assert canvas.hasMouseTracking()


def test_the_point_of_a_gaze_is_that_in_the_frame(canvas):
    assert canvas.point_of(Gaze(0.25, 0.25)) == QPointF(80, 90)
    # With black beside the frame instead.
    canvas.resize(480, 120)
    assert canvas.point_of(Gaze(0.25, 0.25)) == QPointF(160, 30)


def test_the_frame_is_drawn_between_black_bars(canvas):
    canvas.write([], [], False)
    seen = pixels(canvas)
    assert not seen[:58].any()
    assert not seen[182:].any()
    assert (seen[64:176, 4:150] == [200, 100, 50]).all()
    assert (seen[64:176, 170:316] == [10, 20, 30]).all()


def test_the_ring_is_where_the_disc_of_the_shown_frame_is(canvas):
    with_ring = pixels(canvas).astype(int)
    canvas.write([], [], False)
    drawn = np.abs(with_ring - pixels(canvas)).sum(axis=2) > 0
    y, x = np.nonzero(drawn)
    # 15 % of 120 rows, around the middle.
    distance = np.hypot(x + 0.5 - 160, y + 0.5 - 120)
    assert distance.min() > 16
    assert distance.max() < 20
    canvas.write([], [], True)
    assert (pixels(canvas) == with_ring).all()


def test_each_frame_is_reported_once_when_it_is_painted(canvas):
    painted: list[Any] = []
    canvas.painted.connect(painted.append)
    pixels(canvas)
    pixels(canvas)
    assert len(painted) == 1
    newer = shown()
    canvas.show_frame(newer)
    assert len(painted) == 1
    pixels(canvas)
    assert painted[1] is newer


def test_qt_paints_again_only_when_something_has_changed(canvas):
    class Paints(QObject):
        """Counts paint events."""

        count = 0

        def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
            self.count += event.type() == QEvent.Type.Paint
            return False

    paints = Paints()
    canvas.installEventFilter(paints)
    canvas.show()
    QApplication.processEvents()
    for act, painted in (
        (lambda: canvas.show_frame(shown()), True),
        (lambda: canvas.write(["frame 40 ms"], [], True), True),
        (lambda: canvas.write(["frame 40 ms"], [], True), False),
        (lambda: canvas.write(["frame 40 ms"], ["help"], True), True),
        (lambda: canvas.write(["frame 40 ms"], ["help"], False), True),
    ):
        before = paints.count
        act()
        QApplication.processEvents()
        assert (paints.count > before) == painted
    canvas.hide()


def test_lines_are_white_on_a_shade_of_the_frame(canvas):
    canvas.show_frame(shown(image=np.full((240, 320, 3), 200, dtype=np.uint8)))
    canvas.write(["frame 40 ms"], [], False)
    seen = pixels(canvas)
    assert (seen[0, 0] == seen[3, 3]).all()
    # 105 of 255 parts of the frame are left.
    assert seen[3, 3] == pytest.approx([82] * 3, abs=2)
    assert (seen == 255).all(axis=2).any()
    assert (seen[239] == 200).all()


def test_the_shade_fits_its_lines_with_a_margin_of_eight_pixels(canvas):
    canvas.show_frame(shown(image=np.full((240, 320, 3), 60, dtype=np.uint8)))

    def boxes(hud: list[str], overlay: list[str]) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Left, top, right and bottom of the shade, and of the text on it."""
        canvas.write(hud, overlay, False)
        seen = pixels(canvas)
        found = []
        for where in ((seen != 60).any(axis=2), (seen > 100).all(axis=2)):
            y, x = np.nonzero(where)
            found.append((x.min(), y.min(), x.max() + 1, y.max() + 1))
        return found[0], found[1]

    one, text = boxes(["MMMM"], [])
    two, _ = boxes(["MMMM", "MMMM"], [])
    assert one[:2] == two[:2] == (0, 0)
    assert one[2] == two[2]
    assert 2 * one[3] - two[3] == pytest.approx(16, abs=1)
    assert [text[0] - one[0], one[2] - text[2]] == pytest.approx([8, 8], abs=2)
    middle, text = boxes([], ["MMMM", "MMMM", "MMMM"])
    assert [middle[0] + middle[2], middle[1] + middle[3]] == pytest.approx([320, 240], abs=2)
    assert [text[0] - middle[0], middle[2] - text[2]] == pytest.approx([8, 8], abs=2)
    assert text[1] - middle[1] == pytest.approx(middle[3] - text[3], abs=6)


def test_lines_are_drawn_in_the_corner_and_in_the_middle(canvas):
    before = pixels(canvas).astype(int)
    canvas.write(["frame 40 ms"], [], True)
    corner = np.argwhere(np.abs(pixels(canvas) - before).sum(axis=2) > 0)
    assert (corner.min(axis=0) < 20).all()
    assert (corner.max(axis=0) < [60, 200]).all()
    canvas.write([], ["help", "more help"], True)
    middle = np.argwhere(np.abs(pixels(canvas) - before).sum(axis=2) > 0)
    assert middle.mean(axis=0) == pytest.approx([119.5, 159.5], abs=15)
    canvas.write([], [], True)
    assert (pixels(canvas) == before).all()


def test_the_mouse_is_reported_with_its_button(canvas):
    happened = events(canvas)
    move, press, release = QEvent.Type.MouseMove, QEvent.Type.MouseButtonPress, QEvent.Type.MouseButtonRelease
    left, none = Qt.MouseButton.LeftButton, Qt.MouseButton.NoButton
    mouse(canvas, move, 80, 90, none)
    mouse(canvas, press, 80, 90, left)
    mouse(canvas, release, 104, 78, left)
    mouse(canvas, press, 80, 90, Qt.MouseButton.RightButton)
    assert [(one["type"], one["x"], one["y"], one["button"]) for one in happened] == [
        ("pointer_move", 80, 90, 0),
        ("pointer_down", 80, 90, 1),
        ("pointer_up", 104, 78, 1),
        ("pointer_down", 80, 90, 0),
    ]
