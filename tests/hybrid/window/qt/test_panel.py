"""The controls as widgets, and the dock that shows them: in full width, scrolled where it is too low."""

from __future__ import annotations

import pytest

pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QApplication,
    QCheckBox,
    QComboBox,
    QDockWidget,
    QLabel,
    QScrollArea,
    QSlider,
    QWidget,
)

from hybrid.render.frame_settings import INTERACTIVE, FrameSettings
from hybrid.window.controls import Controls, Playback
from hybrid.window.main_window import Panel, controls_dock

_KINDS = {"slider": QSlider, "list": QComboBox, "switch": QCheckBox}


@pytest.fixture
def panel(application) -> Panel:
    """Of a scene that moves."""
    controls = Controls(FrameSettings(fov_a=15.0, fov_b=11.0, spp=1), None, 4, Playback(4.0))
    panel = Panel(controls)
    panel.controls = controls
    return panel


def test_every_control_has_its_widget_and_value(panel):
    for control in panel.controls.all:
        widget = panel.widgets[control.name]
        assert type(widget) is _KINDS[control.kind]
        assert panel.isAncestorOf(widget)
    assert (panel.widgets["fov-a"].maximum(), panel.widgets["fov-a"].value()) == (75, 15)
    assert panel.widgets["acuity model"].currentText() == panel.controls.settings().acuity_model
    assert not panel.widgets["keep FPS"].isChecked()
    assert "fov-a 15 %" in {label.text() for label in panel.findChildren(QLabel)}


def test_what_is_chosen_by_hand_is_reported(panel):
    chosen = []
    panel.chosen.connect(lambda name, value: chosen.append((name, value)))
    panel.widgets["samples"].setValue(3)
    panel.widgets["view"].setCurrentIndex(2)
    panel.widgets["keep FPS"].setChecked(True)
    assert chosen == [("samples", 3), ("view", 2), ("keep FPS", 1)]


def test_values_are_shown_and_not_reported(panel):
    chosen = []
    panel.chosen.connect(lambda name, value: chosen.append(name))
    for name, value in (("fov-a", 5), ("view", 3), ("keep FPS", 1), ("play", 1)):
        panel.controls.set(name, value)
    panel.refresh()
    assert panel.widgets["fov-a"].value() == panel.widgets["fov-b"].value() == 5
    assert panel.widgets["view"].currentIndex() == 3
    assert panel.widgets["play"].isChecked()
    # The target chooses them.
    assert not panel.widgets["samples"].isEnabled()
    assert {"fov-a 5 %", "fov-b 5 %"} <= {label.text() for label in panel.findChildren(QLabel)}
    assert chosen == []


def test_no_control_takes_keys_from_the_frame(panel):
    policies = {control.focusPolicy() for control in panel.findChildren(QWidget)}
    assert policies == {Qt.FocusPolicy.NoFocus}


def test_the_dock_is_as_wide_as_its_panel_and_may_be_lower(application):
    panel = Panel(Controls(INTERACTIVE, None, 4))
    wanted = panel.sizeHint()
    dock = controls_dock(panel)
    scrolled = dock.widget()
    assert isinstance(scrolled, QScrollArea)
    assert scrolled.widget() is panel
    assert scrolled.minimumWidth() > wanted.width()
    dock.resize(dock.minimumSizeHint())
    dock.show()
    assert dock.height() < wanted.height()
    assert scrolled.verticalScrollBar().maximum() > 0
    assert panel.width() >= wanted.width()
    assert not scrolled.horizontalScrollBar().isVisible()
    dock.resize(dock.width(), 2 * wanted.height())
    QApplication.processEvents()
    # With more room than it needs, the panel fills it.
    assert panel.height() > 1.5 * wanted.height()
    dock.hide()


def test_the_dock_can_be_neither_moved_nor_closed(application):
    dock = controls_dock(Panel(Controls(INTERACTIVE, None, 4)))
    assert dock.features() == QDockWidget.DockWidgetFeature.NoDockWidgetFeatures
