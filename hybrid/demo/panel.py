"""The controls beside the frame."""

from __future__ import annotations

from dataclasses import replace

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QFormLayout, QLabel, QSlider, QSpinBox, QWidget

from compose.eye.acuity import ACUITY_MODELS
from hybrid.interactive.request import Settings, Shows

_MOST_RADIUS, _MOST_SPP, _LEAST_SCALE, _MOST_RATE = 75, 16, 25, 3
_SLIDER_WIDTH, _LETTERS = 100, 12


class Panel(QWidget):
    """Sliders and lists; what is chosen with them is always a valid setting.

    Args:
        settings: to begin with.
        layers: of the forest.
    """

    changed = Signal()

    def __init__(self, settings: Settings, layers: int):
        super().__init__()
        self._form = QFormLayout(self)
        self._chosen: Settings | None = None
        # Before anyone else hears of a change.
        self.changed.connect(self._forget)
        low, high = settings.layers or (1, layers)
        self.shows = self._list("view", [shows.value for shows in Shows], Shows.COMPOSITE.value)
        self.fov_a = self._slider("fov-a", 0, _MOST_RADIUS, round(settings.fov_a), " %")
        self.fov_b = self._slider("fov-b", 0, _MOST_RADIUS, round(settings.fov_b), " %")
        self.spp = self._slider("samples", 1, _MOST_SPP, settings.spp, "")
        self.acuity_model = self._list("acuity_model", list(ACUITY_MODELS), settings.acuity_model)
        self.coarsest = self._slider("coarsest layer", 1, layers, low, "")
        self.finest = self._slider("finest layer", 1, layers, high, "")
        self.rate = self._slider("coarser rate", 0, _MOST_RATE, settings.rate, "")
        self.scale = self._slider("scale", _LEAST_SCALE, 100, round(100 * settings.scale), " %")
        self.controlled = QCheckBox("keep FPS")
        self.controlled.setChecked(settings.target_fps is not None)
        self.target = QSpinBox(minimum=1, maximum=120)
        self.target.setValue(round(settings.target_fps or 15))
        self._form.addRow(self.controlled, self.target)
        # Keys belong to the frame: with the focus here, arrows and letters would change what is chosen.
        for control in self.findChildren(QWidget):
            control.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.fov_a.valueChanged.connect(lambda value: self.fov_b.setValue(min(self.fov_b.value(), value)))
        self.fov_b.valueChanged.connect(lambda value: self.fov_a.setValue(max(self.fov_a.value(), value)))
        self.coarsest.valueChanged.connect(
            lambda value: self.finest.setValue(max(self.finest.value(), value))
        )
        self.finest.valueChanged.connect(
            lambda value: self.coarsest.setValue(min(self.coarsest.value(), value))
        )
        self.controlled.toggled.connect(self._mark_chosen)
        self.controlled.toggled.connect(self.changed)
        self.target.valueChanged.connect(self.changed)
        self._mark_chosen(self.controlled.isChecked())
        # Until something is changed by hand: sliders know whole numbers only.
        self._chosen = replace(settings, layers=(low, high))

    def settings(self) -> Settings:
        """What is chosen; the same object as long as that is the same."""
        if self._chosen is None:
            self._chosen = self._read()
        return self._chosen

    def _forget(self) -> None:
        self._chosen = None

    def _read(self) -> Settings:
        # While one slider moves, the one that follows it is still where it was.
        return Settings(
            float(self.fov_a.value()),
            float(min(self.fov_b.value(), self.fov_a.value())),
            self.spp.value(),
            self.acuity_model.currentText(),
            (min(self.coarsest.value(), self.finest.value()), self.finest.value()),
            self.rate.value(),
            self.scale.value() / 100,
            float(self.target.value()) if self.controlled.isChecked() else None,
        )

    def chosen_view(self) -> Shows:
        """What is to be shown."""
        return Shows(self.shows.currentText())

    def _mark_chosen(self, controlled: bool) -> None:
        """What the controller chooses cannot be chosen by hand at the same time."""
        for control in (self.spp, self.finest, self.coarsest, self.rate, self.scale):
            control.setEnabled(not controlled)

    def _slider(self, name: str, low: int, high: int, value: int, unit: str) -> QSlider:
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
        box = QComboBox()
        box.addItems(entries)
        # The longest entry must not decide how much is left for the frame.
        box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        box.setMinimumContentsLength(_LETTERS)
        box.setCurrentText(chosen)
        box.currentTextChanged.connect(self.changed)
        self._form.addRow(name, box)
        return box
