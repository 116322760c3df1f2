"""The controls beside the frame, and the side of the window that holds them."""

from __future__ import annotations

from dataclasses import replace

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDockWidget,
    QFormLayout,
    QLabel,
    QScrollArea,
    QSlider,
    QSpinBox,
    QWidget,
)

from compose.eye.acuity import ACUITY_MODELS
from hybrid.render.frame_settings import FrameSettings
from hybrid.window.messages import ShownView
from hybrid.window.navigation import Playback

# Ends of the sliders: radii and scale in percent.
_MOST_RADIUS, _MOST_SPP, _LEAST_SCALE, _MOST_RATE = 75, 16, 25, 3
# Ends and default of the target, in frames per second.
_LEAST_FPS, _MOST_FPS, _DEFAULT_FPS = 1, 120, 15
# Speeds of a scene that moves, and steps of its time.
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
_TIME_STEPS = 1000
# Widths of a slider in pixels, and of a list in letters.
_SLIDER_WIDTH, _LETTERS = 100, 12


class Panel(QWidget):
    """Sliders and lists; what is chosen with them is a valid setting at every moment.

    Until something is changed by hand, the settings are exactly the initial ones, which sliders, with their
    whole numbers, may only approximate; what no control changes stays as it is. The playback is None if the
    scene stands still, which has no controls of time.
    """

    changed = Signal()

    def __init__(
        self, settings: FrameSettings, target_fps: float | None, layers: int, playback: Playback | None = None
    ):
        super().__init__()
        self._form = QFormLayout(self)
        self._initial, self._initial_target = settings, target_fps
        self._touched = False
        self._chosen: FrameSettings | None = None
        # Before anyone else hears of a change.
        self.changed.connect(self._forget)
        low, high = settings.layers or (1, layers)
        self.views = self._list("view", [view.value for view in ShownView], ShownView.COMPOSITE.value)
        self.fov_a = self._slider("fov-a", 0, _MOST_RADIUS, round(settings.fov_a), " %")
        self.fov_b = self._slider("fov-b", 0, _MOST_RADIUS, round(settings.fov_b), " %")
        self.spp = self._slider("samples", 1, _MOST_SPP, settings.spp, "")
        self.acuity_model = self._list("acuity model", list(ACUITY_MODELS), settings.acuity_model)
        self.coarsest = self._slider("coarsest layer", 1, layers, low, "")
        self.finest = self._slider("finest layer", 1, layers, high, "")
        self.rate = self._slider("finest rate", 0, _MOST_RATE, settings.rate, "")
        self.scale = self._slider("scale", _LEAST_SCALE, 100, round(100 * settings.scale), " %")
        self.play: QCheckBox | None = None
        if playback is not None:
            self._add_time(playback)
        self.controlled = QCheckBox("keep FPS")
        self.controlled.setChecked(target_fps is not None)
        self.target = QSpinBox(minimum=_LEAST_FPS, maximum=_MOST_FPS)
        self.target.setValue(round(target_fps or _DEFAULT_FPS))
        self._form.addRow(self.controlled, self.target)
        # Keys belong to the frame: a control with the focus would react to arrows and letters.
        for control in self.findChildren(QWidget):
            control.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        # The ends of a range push each other.
        for lower, upper in ((self.fov_b, self.fov_a), (self.coarsest, self.finest)):
            lower.valueChanged.connect(lambda value, end=upper: end.setValue(max(end.value(), value)))
            upper.valueChanged.connect(lambda value, end=lower: end.setValue(min(end.value(), value)))
        self.controlled.toggled.connect(self._enable_manual)
        self.controlled.toggled.connect(self.changed)
        self.target.valueChanged.connect(self.changed)
        self._enable_manual(self.controlled.isChecked())
        self._chosen = replace(settings, layers=(low, high))

    def _add_time(self, playback: Playback) -> None:
        """Adds the controls of a scene that moves. They change no setting: the window asks the playback."""
        self.play, self.speed, self.time = QCheckBox("play"), QComboBox(), QSlider(Qt.Orientation.Horizontal)
        self.play.toggled.connect(lambda on: setattr(playback, "playing", on))
        self.speed.addItems([f"{speed:g} x" for speed in _SPEEDS])
        self.speed.setCurrentIndex(_SPEEDS.index(playback.speed))
        self.speed.currentIndexChanged.connect(lambda n: setattr(playback, "speed", _SPEEDS[n]))
        self.time.setRange(0, _TIME_STEPS)
        self._time_label = QLabel()
        self.time.valueChanged.connect(lambda value: playback.seek(value / _TIME_STEPS))
        self.time.valueChanged.connect(lambda value: self.show_time(value / _TIME_STEPS))
        self.show_time(0.0)
        self._form.addRow(self.play, self.speed)
        self._form.addRow(self._time_label, self.time)

    def show_time(self, time: float) -> None:
        """Moves the slider of a scene that moves, without seeking the time that it stands for."""
        blocked = self.time.blockSignals(True)
        self.time.setValue(round(time * _TIME_STEPS))
        self.time.blockSignals(blocked)
        self._time_label.setText(f"time {time:.2f}")

    def settings(self) -> FrameSettings:
        """The chosen settings; the same object until one of them changes."""
        if self._chosen is None:
            self._chosen = replace(
                self._initial,
                fov_a=float(self.fov_a.value()),
                # While one slider moves, the one that it pushes has not moved yet.
                fov_b=float(min(self.fov_b.value(), self.fov_a.value())),
                spp=self.spp.value(),
                acuity_model=self.acuity_model.currentText(),
                layers=(min(self.coarsest.value(), self.finest.value()), self.finest.value()),
                rate=self.rate.value(),
                scale=self.scale.value() / 100,
            )
        return self._chosen

    @property
    def target_fps(self) -> float | None:
        """Frames per second to keep; None for no target."""
        if not self._touched:
            return self._initial_target
        return float(self.target.value()) if self.controlled.isChecked() else None

    @property
    def view(self) -> ShownView:
        """The chosen view."""
        return ShownView(self.views.currentText())

    def _forget(self) -> None:
        self._touched, self._chosen = True, None

    def _enable_manual(self, controlled: bool) -> None:
        """Disables what the controller chooses, or enables it again."""
        for control in (self.spp, self.finest, self.coarsest, self.rate, self.scale):
            control.setEnabled(not controlled)

    def _slider(self, name: str, low: int, high: int, value: int, unit: str) -> QSlider:
        """Adds a slider with its value in its label."""
        slider, label = QSlider(Qt.Orientation.Horizontal), QLabel()
        slider.setRange(low, high)
        slider.setMinimumWidth(_SLIDER_WIDTH)
        slider.valueChanged.connect(lambda now: label.setText(f"{name} {now}{unit}"))
        slider.setValue(value)
        label.setText(f"{name} {slider.value()}{unit}")
        slider.valueChanged.connect(self.changed)
        self._form.addRow(label, slider)
        return slider

    def _list(self, name: str, entries: list[str], chosen: str) -> QComboBox:
        """Adds a list of which one entry is chosen."""
        box = QComboBox()
        box.addItems(entries)
        # The longest entry must not take the room of the frame.
        box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        box.setMinimumContentsLength(_LETTERS)
        box.setCurrentText(chosen)
        box.currentTextChanged.connect(self.changed)
        self._form.addRow(name, box)
        return box


def controls_dock(panel: Panel) -> QDockWidget:
    """A dock that shows a panel in its full width and scrolls it where it is too high."""
    # Without scrolling, a small frame would grow to the height of the controls.
    scrolled = QScrollArea()
    scrolled.setWidget(panel)
    scrolled.setWidgetResizable(True)
    scrolled.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
    bar = scrolled.verticalScrollBar().sizeHint().width()
    scrolled.setFixedWidth(panel.sizeHint().width() + bar)
    dock = QDockWidget("controls")
    dock.setWidget(scrolled)
    dock.setFeatures(QDockWidget.DockWidgetFeature.NoDockWidgetFeatures)
    return dock
