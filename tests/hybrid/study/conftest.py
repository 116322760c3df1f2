"""Windows in memory, as the tests of the window have them."""

from tests.hybrid.window.qt.conftest import application, offscreen, only_application

__all__ = ["application", "offscreen", "only_application"]
