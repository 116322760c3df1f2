"""A study in a window of Qt: full screen, every picture when the design wants it, and how late it was."""

from __future__ import annotations

import signal
import sys
import time
from typing import Any

from PySide6.QtCore import QPointF, QRectF, Qt, QTimer
from PySide6.QtGui import QColor, QImage, QKeyEvent, QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import (
    QApplication,
    QComboBox,
    QFormLayout,
    QFrame,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QScrollArea,
    QStackedLayout,
    QVBoxLayout,
    QWidget,
)

from compose.base.errors import UserError
from hybrid.study.session import Step, StudySession

# A picture counts as late when it is shown this many display intervals after its time.
_LATE = 1.5
# Arms and width of the cross in pixels.
_ARM, _WIDTH = 12.0, 2.0
# Width of text in pixels.
_COLUMN = 760
_STYLE = """
QWidget { color: #e8e8e8; font-size: 18px; background: %s }
QLabel#title { font-size: 28px; font-weight: 600 }
QPushButton { padding: 12px 28px; border: 1px solid #888; border-radius: 6px; background: #2a2a2a }
QPushButton:disabled { color: #777 } QPushButton:hover, QPushButton:focus { border-color: #fff }
QLineEdit, QComboBox { padding: 6px; border: 1px solid #888; background: #1c1c1c; min-width: 260px }
"""


class Player(QWidget):
    """Shows the phases of one trial, then its question; replies once it is answered or the time is up."""

    def __init__(self, window: StudyWindow, session: StudySession, interval: float):
        super().__init__()
        self._session, self._step, self._interval = session, session.step, interval
        self._reply, self._fail = window.reply, window.fail
        step = self._step
        self._background = QColor(*step["background"])
        self._images: dict[tuple[str, int], QImage] = {}
        names = {(one["clip"], one["frames"]) for one in step["phases"] if one["clip"]}
        self._wanted = [(name, frame) for name, count in sorted(names) for frame in range(count)]
        self._phase, self._frame, self._loaded = -1, 0, False
        # time.perf_counter of the first picture of each phase, and of the question.
        self._starts: list[float] = []
        self._counts = [{"dropped": 0, "late": 0} for _ in step["phases"]]
        self._gaze: list[list[float]] = []
        self._panel = self._question()
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setTimerType(Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(self._due)
        self.setMouseTracking(True)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        if step["gaze"] != "mouse":
            self.setCursor(Qt.CursorShape.BlankCursor)
        QTimer.singleShot(0, self._load)

    @property
    def phase(self) -> dict[str, Any] | None:
        """The phase that is shown; None before the first, and after the last."""
        phases = self._step["phases"]
        return phases[self._phase] if 0 <= self._phase < len(phases) else None

    @property
    def asks(self) -> bool:
        """Whether the question is shown."""
        return self._panel.isVisible()

    def _question(self) -> QWidget:
        panel, answers = QWidget(self), QHBoxLayout()
        answers.addStretch()
        for one in self._step["answers"]:
            button = QPushButton(f"{one['key']}  {one['label']}")
            button.clicked.connect(lambda _=False, value=one["value"]: self._answer(value))
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            answers.addWidget(button)
        answers.addStretch()
        count = QLabel(f"{self._step['number']} of {self._step['of']}")
        layout = QVBoxLayout(panel)
        layout.setSpacing(24)
        layout.addStretch()
        for label in (QLabel(self._step["question"]), count):
            layout.addWidget(label, alignment=Qt.AlignmentFlag.AlignCenter)
        layout.addLayout(answers)
        layout.addStretch()
        panel.hide()
        return panel

    def _load(self) -> None:
        if self._wanted:
            name, frame = self._wanted.pop()
            file = self._session.folder / "clips" / name / f"{frame:06}.png"
            image = QImage(str(file))
            if image.isNull():
                self._fail(UserError(f"{file}: is missing or damaged; design the study again"))
                return
            self._images[name, frame] = image.convertToFormat(QImage.Format.Format_RGB32)
            QTimer.singleShot(0, self._load)
            return
        self._loaded = True
        self._next_phase()

    def _next_phase(self) -> None:
        self._phase, self._frame = self._phase + 1, 0
        if self._phase == len(self._step["phases"]):
            self._ask()
            return
        self.repaint()
        self._starts.append(time.perf_counter())
        self._wait()

    def _wait(self) -> None:
        phase, start = self._step["phases"][self._phase], self._starts[-1]
        due = start + phase["seconds"]
        if self._frame + 1 < phase["frames"]:
            due = min(due, start + (self._frame + 1) / phase["fps"])
        left = max(0, round(1000 * (due - time.perf_counter())))
        self._timer.start(left)

    def _due(self) -> None:
        phase, start, now = self._step["phases"][self._phase], self._starts[-1], time.perf_counter()
        # A picture that is due within half of the display's interval is shown now.
        passed = now - start + self._interval / 2
        if passed >= phase["seconds"]:
            self._counts[self._phase]["dropped"] += max(0, phase["frames"] - 1 - self._frame)
            self._next_phase()
            return
        frame = min(int(passed * phase["fps"]), phase["frames"] - 1)
        if frame > self._frame:
            counts = self._counts[self._phase]
            counts["dropped"] += frame - self._frame - 1
            self._frame = frame
            self.repaint()
            late = time.perf_counter() - start - frame / phase["fps"]
            counts["late"] += late > _LATE * self._interval
        self._wait()

    def _ask(self) -> None:
        self.unsetCursor()
        self._panel.setGeometry(self.rect())
        self._panel.show()
        self.repaint()
        self._panel.repaint()
        self._starts.append(time.perf_counter())
        if self._step["seconds_to_answer"] is not None:
            QTimer.singleShot(round(1000 * self._step["seconds_to_answer"]), self, lambda: self._answer(None))

    def _answer(self, value: int | None) -> None:
        passed = time.perf_counter() - self._starts[-1]
        if not self.isVisible() or (value is not None and passed < self._step["least_seconds"]):
            return
        phases = [
            {"asked_ms": 1000 * one["seconds"], "shown_ms": 1000 * (end - start), **counts}
            for one, start, end, counts in zip(
                self._step["phases"], self._starts[:-1], self._starts[1:], self._counts, strict=True
            )
        ]
        found = {"step": self._step["id"], "answer": value, "reaction_ms": 1000 * passed, "phases": phases}
        self._reply({**found, "interval_ms": 1000 * self._interval, "gaze": self._gaze})

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        values = {one["key"]: one["value"] for one in self._step["answers"]}
        if self.asks and event.text() in values:
            self._answer(values[event.text()])
        else:
            super().keyPressEvent(event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        if self._step["gaze"] == "mouse" and self._starts:
            frame, at = self._rectangle(), event.position()
            ms = 1000 * (time.perf_counter() - self._starts[0])
            x, y = (at.x() - frame.x()) / frame.width(), (at.y() - frame.y()) / frame.height()
            self._gaze.append([ms, x, y])

    def _rectangle(self) -> QRectF:
        """Where frames are: one to one in pixels of the screen, or smaller if they do not fit."""
        ratio = self.devicePixelRatioF()
        width, height = (side / ratio for side in self._step["size"])
        scale = min(1.0, self.width() / width, self.height() / height)
        width, height = width * scale, height * scale
        # On whole pixels of the screen, so that nothing is smoothed.
        left, top = (round((self.width() - width) / 2 * ratio), round((self.height() - height) / 2 * ratio))
        return QRectF(left / ratio, top / ratio, width, height)

    def paintEvent(self, event: QPaintEvent) -> None:  # noqa: N802
        painter = QPainter(self)
        painter.fillRect(self.rect(), self._background)
        if not self._loaded:
            painter.setPen(Qt.GlobalColor.lightGray)
            painter.drawText(self.rect(), Qt.AlignmentFlag.AlignCenter, "loading")
        elif self.phase is not None:
            self._paint_phase(painter, self.phase)
        painter.end()

    def _paint_phase(self, painter: QPainter, phase: dict[str, Any]) -> None:
        frame = self._rectangle()
        if phase["clip"] is not None:
            image = self._images[phase["clip"], self._frame]
            smaller = frame.width() * self.devicePixelRatioF() < image.width() - 0.5
            painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform, smaller)
            painter.drawImage(frame, image)
        if phase["label"]:
            painter.setPen(Qt.GlobalColor.white)
            above = QRectF(frame.x(), max(0.0, frame.y() - 40), frame.width(), 36)
            painter.drawText(above, Qt.AlignmentFlag.AlignCenter, phase["label"])
        if phase["marker"]:
            x, y = phase["marker"][min(self._frame, len(phase["marker"]) - 1)]
            at = QPointF(frame.x() + x * frame.width(), frame.y() + y * frame.height())
            # A cross that is seen on bright and on dark.
            for colour, width in ((Qt.GlobalColor.black, 3 * _WIDTH), (Qt.GlobalColor.white, _WIDTH)):
                painter.setPen(QPen(colour, width))
                for arm in (QPointF(_ARM, 0), QPointF(0, _ARM)):
                    painter.drawLine(at - arm, at + arm)


class StudyWindow(QWidget):
    """Shows one step of a session after the other; closing it keeps what has been answered."""

    def __init__(self, session: StudySession):
        super().__init__()
        self.setWindowTitle("Study")
        self._session = session
        self._layout = QStackedLayout(self)
        # What goes on to the next step; None in a trial.
        self.button: QPushButton | None = None
        self.error: UserError | None = None
        QTimer.singleShot(0, self._show)

    @property
    def page(self) -> QWidget:
        """What is shown now."""
        return self._layout.currentWidget()

    @property
    def question_is_shown(self) -> bool:
        """Whether a trial's question can be answered now."""
        return isinstance(self.page, Player) and self.page.asks

    def reply(self, reply: dict[str, Any]) -> None:
        """Takes a reply, and shows the next step."""
        try:
            self._session.answer(reply)
        except UserError as error:
            self.fail(error)
        else:
            self._show()

    def fail(self, error: UserError) -> None:
        """Closes the window because of an error, which `run_study_window` raises."""
        self.error = error
        self.close()

    def _show(self) -> None:
        step = self._session.step
        background = ",".join(map(str, step.get("background", (16, 16, 16))))
        # First, because texts have their size from it.
        self.setStyleSheet(_STYLE % f"rgb({background})")
        page: QWidget
        if step["kind"] == "trial":
            # Screens that do not exist report no rate.
            rate = self.screen().refreshRate()
            self.button, page = None, Player(self, self._session, 1 / rate if rate > 0 else 1 / 60)
        else:
            page = self._page(step)
        before = self._layout.currentWidget()
        self._layout.addWidget(page)
        self._layout.setCurrentWidget(page)
        if before is not None:
            self._layout.removeWidget(before)
            before.deleteLater()
        page.setFocus()

    def _page(self, step: Step) -> QWidget:
        page, heading = QWidget(self), QLabel(step["title"])
        heading.setObjectName("title")
        entries: dict[str, QLineEdit | QComboBox] = {}
        content = _form(step, entries) if step["kind"] == "form" else self._text(step["body"], page)

        def reply() -> None:
            values = {
                name: entry.currentText() if isinstance(entry, QComboBox) else entry.text()
                for name, entry in entries.items()
            }
            self.reply({"step": step["id"], "values": values})

        end = step["kind"] == "end"
        self.button = button = QPushButton("Close" if end else step["button"])
        button.clicked.connect(self.close if end else reply)
        if step.get("seconds"):
            button.setEnabled(False)
            QTimer.singleShot(round(1000 * step["seconds"]), button, lambda: button.setEnabled(True))
        layout = QVBoxLayout(page)
        layout.setSpacing(28)
        layout.addStretch()
        for widget in (heading, content, button):
            layout.addWidget(widget, alignment=Qt.AlignmentFlag.AlignCenter)
        layout.addStretch()
        return page

    def _text(self, text: str, page: QWidget) -> QWidget:
        """As high as the text; what does not fit on the screen is scrolled."""
        body, screen = QLabel(text, page), self.screen().size()
        body.setWordWrap(True)
        body.ensurePolished()
        width = min(_COLUMN, screen.width() - 80)
        scroll = QScrollArea(page)
        scroll.setWidget(body)
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QFrame.Shape.NoFrame)
        scroll.setFixedSize(width + 20, min(body.heightForWidth(width) + 4, round(0.6 * screen.height())))
        return scroll

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        if event.key() == Qt.Key.Key_Escape:
            self.close()
        elif self.button is not None and event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Space):
            self.button.click()


def _form(step: Step, entries: dict[str, QLineEdit | QComboBox]) -> QWidget:
    """The fields of a form, which are added to the entries, by name."""
    holder = QWidget()
    form = QFormLayout(holder)
    for one in step["fields"]:
        entry = QComboBox() if one["type"] == "choice" else QLineEdit()
        if isinstance(entry, QComboBox):
            entry.addItems(["", *one["choices"]])
        entries[one["name"]] = entry
        form.addRow(one["label"], entry)
    return holder


def run_study_window(session: StudySession) -> None:
    """Runs a session in a window until it is complete or closed; what has been answered is kept."""
    application = QApplication.instance() or QApplication(sys.argv[:1])
    window = StudyWindow(session)
    window.showFullScreen()
    # Qt does not notice Ctrl-C by itself.
    signal.signal(signal.SIGINT, lambda number, frame: window.close())
    timer = QTimer()
    timer.timeout.connect(lambda: None)
    timer.start(200)
    application.exec()
    if window.error is not None:
        raise window.error
