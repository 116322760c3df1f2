"""Controls beside the frame: in full width, and scrolled where they are too high."""

from __future__ import annotations

import pytest

pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)

from PySide6.QtWidgets import QApplication, QDockWidget, QScrollArea

from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window.controls import Controls
from hybrid.window.main_window import Panel, controls_dock


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


def test_it_can_be_neither_moved_nor_closed(application):
    dock = controls_dock(Panel(Controls(INTERACTIVE, None, 4)))
    assert dock.features() == QDockWidget.DockWidgetFeature.NoDockWidgetFeatures
