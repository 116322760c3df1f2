"""Windows in memory."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture(scope="session")
def offscreen() -> dict[str, str]:
    """Environment in which Qt opens windows in memory."""
    pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)
    from hybrid.window.qt_check import tried

    environment = os.environ | {"QT_QPA_PLATFORM": "offscreen"}
    if tried(environment).returncode != 0:
        pytest.skip("Qt can open no window here, not even in memory: its libraries are missing")
    return environment


@pytest.fixture(scope="session")
def only_application(offscreen) -> Any:
    """Qt in this process; it can be started once."""
    from PySide6.QtWidgets import QApplication

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("QT_QPA_PLATFORM", offscreen["QT_QPA_PLATFORM"])
        return QApplication.instance() or QApplication([])


@pytest.fixture
def application(only_application) -> Iterator[Any]:
    """Qt in this process, without windows of other tests."""
    yield only_application
    # Windows refer to themselves. If the collector found them on a render thread, Qt would crash.
    gc.collect()
