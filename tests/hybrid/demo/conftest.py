"""Windows in memory."""

from __future__ import annotations

import os
from typing import Any

import pytest


@pytest.fixture(scope="session")
def offscreen() -> dict[str, str]:
    """Environment in which Qt opens windows in memory."""
    pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)
    from hybrid.demo.qt import tried

    environment = os.environ | {"QT_QPA_PLATFORM": "offscreen"}
    if tried(environment).returncode != 0:
        pytest.skip("Qt can open no window here, not even in memory: its libraries are missing")
    return environment


@pytest.fixture(scope="session")
def application(offscreen) -> Any:
    """Qt in this process."""
    from PySide6.QtWidgets import QApplication

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("QT_QPA_PLATFORM", offscreen["QT_QPA_PLATFORM"])
        return QApplication.instance() or QApplication([])
