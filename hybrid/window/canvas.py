"""The part of the window that shows the frame, and knows where the mouse is on it."""

from __future__ import annotations

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QFont, QImage, QMouseEvent, QPainter, QPaintEvent, QPen, QResizeEvent
from PySide6.QtWidgets import QWidget

from compose.eye.gaze import Gaze
from hybrid.window.messages import ShownFrame

_SHADE = QColor(0, 0, 0, 150)
_MARGIN = 8


class Canvas(QWidget):
    """Shows frames in their own proportions, as large as they fit, with lines of text over them."""

    # Gaze: the mouse has moved there.
    gazed = Signal(object)
    # The mouse was dragged to the right and down, in heights of this widget.
    dragged = Signal(float, float)
    # Shown: the newest frame is on the screen.
    painted = Signal(object)
    resized = Signal()

    def __init__(self, size: QSize):
        """A canvas that would like to have a size in pixels of the screen."""
        super().__init__()
        self._hint = size
        self._shown: ShownFrame | None = None
        self._image: QImage | None = None
        self._fresh = False
        self._held: QPointF | None = None
        self._hud: list[str] = []
        self._overlay: list[str] = []
        self._ring = True
        self.setMouseTracking(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMinimumSize(160, 120)

    def sizeHint(self) -> QSize:  # noqa: N802
        return self._hint / self.devicePixelRatioF()

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height in pixels of the screen, of which a scaled screen has several to one of Qt's."""
        ratio = self.devicePixelRatioF()
        return round(self.width() * ratio), round(self.height() * ratio)

    def show_frame(self, shown: ShownFrame) -> None:
        """Shows a frame as soon as Qt paints next."""
        height, width = shown.image.shape[:2]
        # The QImage shares the memory of the array, which `_shown` keeps alive.
        self._shown = shown
        self._image = QImage(shown.image.data, width, height, 3 * width, QImage.Format.Format_RGB888)
        self._fresh = True
        self.update()

    def write(self, hud: list[str], overlay: list[str]) -> None:
        """Shows lines in the upper left corner, and lines in the middle."""
        if (hud, overlay) != (self._hud, self._overlay):
            self._hud, self._overlay = hud, overlay
            self.update()

    def toggle_ring(self) -> None:
        """Shows or hides the ring around the disc."""
        self._ring = not self._ring
        self.update()

    def frame_rectangle(self) -> QRectF:
        """Where the frame is in this widget."""
        if self._image is None:
            return QRectF(self.rect())
        scale = min(self.width() / self._image.width(), self.height() / self._image.height())
        width, height = scale * self._image.width(), scale * self._image.height()
        return QRectF((self.width() - width) / 2, (self.height() - height) / 2, width, height)

    def gaze_of(self, point: QPointF) -> Gaze:
        """The gaze at a point of this widget; outside the frame, the nearest one on its edge."""
        frame = self.frame_rectangle()
        x, y = (point.x() - frame.x()) / frame.width(), (point.y() - frame.y()) / frame.height()
        return Gaze(min(max(x, 0.0), 1.0), min(max(y, 0.0), 1.0))

    def point_of(self, gaze: Gaze) -> QPointF:
        """The point of this widget at a gaze; inverse of `gaze_of`."""
        frame = self.frame_rectangle()
        return QPointF(frame.x() + gaze.x * frame.width(), frame.y() + gaze.y * frame.height())

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        if event.button() == Qt.MouseButton.LeftButton:
            self._held = event.position()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        if event.button() == Qt.MouseButton.LeftButton:
            self._held = None

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        point = event.position()
        if self._held is not None:
            way, self._held = point - self._held, point
            self.dragged.emit(way.x() / self.height(), way.y() / self.height())
        self.gazed.emit(self.gaze_of(point))

    def resizeEvent(self, event: QResizeEvent) -> None:  # noqa: N802
        self.resized.emit()

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        painter = QPainter(self)
        painter.fillRect(self.rect(), Qt.GlobalColor.black)
        frame = self.frame_rectangle()
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
        """Draws lines of text on a shade, in the middle or in the upper left corner."""
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
