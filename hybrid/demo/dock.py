"""The side of the window that holds the controls."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDockWidget, QScrollArea

from hybrid.demo.panel import Panel


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
