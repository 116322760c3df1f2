"""The controls as widgets of Qt, and the side of the window that holds them."""

from __future__ import annotations

from functools import partial

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QDockWidget,
    QFormLayout,
    QLabel,
    QScrollArea,
    QSlider,
    QWidget,
)

from hybrid.window.controls import Control, Controls

# Widths of a slider in pixels, and of a list in letters.
_SLIDER_WIDTH, _LETTERS = 100, 12


class Panel(QWidget):
    """Sliders, lists and switches that show the controls' values.

    Attributes:
        widgets: of the controls, by name.
    """

    # Name and value: a control was changed by hand.
    chosen = Signal(str, int)

    def __init__(self, controls: Controls):
        super().__init__()
        self._controls, form = controls, QFormLayout(self)
        self._labels: dict[str, QLabel] = {}
        self.widgets: dict[str, QSlider | QComboBox | QCheckBox] = {}
        for control in controls.all:
            self.widgets[control.name] = widget = self._widget(control)
            self._labels[control.name] = label = QLabel()
            form.addRow(label, widget)
        # Keys belong to the frame: a control with the focus would react to arrows and letters.
        for widget in self.findChildren(QWidget):
            widget.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._seen: dict[str, int] = {}
        self.refresh()

    def refresh(self) -> None:
        """Shows the values as they are now."""
        if self._seen == self._controls.values:
            return
        self._seen = dict(self._controls.values)
        for control in self._controls.all:
            widget, value = self.widgets[control.name], self._controls.values[control.name]
            with QSignalBlocker(widget):
                if isinstance(widget, QSlider):
                    widget.setValue(value)
                elif isinstance(widget, QComboBox):
                    widget.setCurrentIndex(value)
                else:
                    widget.setChecked(bool(value))
            widget.setEnabled(self._controls.is_enabled(control.name))
            self._labels[control.name].setText(self._controls.text(control))

    def _widget(self, control: Control) -> QSlider | QComboBox | QCheckBox:
        chosen = partial(self.chosen.emit, control.name)
        if control.kind == "slider":
            slider = QSlider(Qt.Orientation.Horizontal)
            slider.setRange(control.low, control.high)
            slider.setMinimumWidth(_SLIDER_WIDTH)
            slider.valueChanged.connect(chosen)
            return slider
        if control.kind == "switch":
            box = QCheckBox()
            box.toggled.connect(lambda on: chosen(int(on)))
            return box
        entries = QComboBox()
        entries.addItems(control.entries)
        # The longest entry must not take the room of the frame.
        entries.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        entries.setMinimumContentsLength(_LETTERS)
        entries.currentIndexChanged.connect(chosen)
        return entries


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
