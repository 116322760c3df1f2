"""The part of Qt's window that shows the frame."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QFont, QImage, QMouseEvent, QPainter, QPaintEvent, QPen, QResizeEvent
from PySide6.QtWidgets import QWidget

from compose.eye.gaze import Gaze
from hybrid.window.messages import ShownFrame
from hybrid.window.viewer import fitted

_SHADE = QColor(0, 0, 0, 150)
_MARGIN = 8


class Canvas(QWidget):
    """Shows frames in their own proportions, as large as they fit, with lines of text over them."""

    # An event of hybrid.window.viewer: of the mouse, or a new size.
    happened = Signal(object)
    # Shown: the newest frame is on the screen.
    painted = Signal(object)

    def __init__(self, size: QSize):
        super().__init__()
        self._hint = size
        self._shown: ShownFrame | None = None
        self._image: QImage | None = None
        self._fresh = False
        self._hud: list[str] = []
        self._overlay: list[str] = []
        self._ring = True
        self.setMouseTracking(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMinimumSize(160, 120)

    def sizeHint(self) -> QSize:  # noqa: N802
        return self._hint / self.devicePixelRatioF()

    def show_frame(self, shown: ShownFrame) -> None:
        """Shows a frame as soon as Qt paints next."""
        height, width = shown.image.shape[:2]
        # The QImage shares the memory of the array, which `_shown` keeps alive.
        self._shown = shown
        self._image = QImage(shown.image.data, width, height, 3 * width, QImage.Format.Format_RGB888)
        self._fresh = True
        self.update()

    def write(self, hud: list[str], overlay: list[str], ring: bool) -> None:
        """Shows lines in the upper left corner, lines in the middle, and the ring around the disc."""
        if (hud, overlay, ring) != (self._hud, self._overlay, self._ring):
            self._hud, self._overlay, self._ring = hud, overlay, ring
            self.update()

    def point_of(self, gaze: Gaze) -> QPointF:
        """The point of this widget at a gaze."""
        frame = self._frame_rectangle()
        return QPointF(frame.x() + gaze.x * frame.width(), frame.y() + gaze.y * frame.height())

    def _frame_rectangle(self) -> QRectF:
        if self._image is None:
            return QRectF(self.rect())
        size = self._image.width(), self._image.height()
        return QRectF(*fitted((self.width(), self.height()), size))

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        self._report("pointer_down", event)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        self._report("pointer_up", event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        self._report("pointer_move", event)

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        # A scaled screen has several pixels to one of Qt's.
        ratio, width, height = self.devicePixelRatioF(), self.width(), self.height()
        pixels = {"pwidth": round(width * ratio), "pheight": round(height * ratio)}
        self.happened.emit({"type": "resize", "width": width, "height": height, **pixels})

    def _report(self, kind: str, event: QMouseEvent) -> None:
        button = 1 if event.button() == Qt.MouseButton.LeftButton else 0
        point = event.position()
        self.happened.emit({"type": kind, "x": point.x(), "y": point.y(), "button": button})

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        painter = QPainter(self)
        painter.fillRect(self.rect(), Qt.GlobalColor.black)
        frame = self._frame_rectangle()
        if self._image is not None and self._shown is not None:
            painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
            painter.drawImage(frame, self._image)
            if self._ring:
                # Around the disc of the frame that is shown, which may be behind the mouse.
                settings = self._shown.request.settings
                radius = settings.fov_a / 100 * frame.height()
                painter.setRenderHint(QPainter.RenderHint.Antialiasing)
                painter.setPen(QPen(QColor(255, 255, 255, 110), 1))
                painter.drawEllipse(self.point_of(settings.gaze), radius, radius)
        self._draw_lines(painter, self._hud, centred=False)
        self._draw_lines(painter, self._overlay, centred=True)
        painter.end()
        if self._fresh:
            self._fresh = False
            self.painted.emit(self._shown)

    def _draw_lines(self, painter: QPainter, lines: list[str], centred: bool) -> None:
        if not lines:
            return
        font = QFont("monospace", 9)
        font.setStyleHint(QFont.StyleHint.TypeWriter)
        painter.setFont(font)
        metrics = painter.fontMetrics()
        width = max(metrics.horizontalAdvance(line) for line in lines) + 2 * _MARGIN
        height = len(lines) * metrics.height() + 2 * _MARGIN
        left, top = ((self.width() - width) / 2, (self.height() - height) / 2) if centred else (0.0, 0.0)
        painter.fillRect(QRectF(left, top, width, height), _SHADE)
        painter.setPen(Qt.GlobalColor.white)
        for number, line in enumerate(lines):
            y = top + _MARGIN + metrics.ascent() + number * metrics.height()
            painter.drawText(QPointF(left + _MARGIN, y), line)
