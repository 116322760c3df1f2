"""Checks whether a window can be opened here."""

from __future__ import annotations

import os
import subprocess
import sys

from compose.base.errors import UserError

# Debian packages with the libraries that Qt's plugin for X11 loads.
_LIBRARIES = (
    "libxcb-cursor0 libxcb-icccm4 libxcb-image0 libxcb-keysyms1 libxcb-render-util0 libxcb-shape0 "
    "libxcb-util1 libxkbcommon-x11-0"
)


def require_window() -> None:
    """UserError if Qt cannot open a window, raised before Qt itself ends the process for that reason."""
    problem = window_problem()
    if problem is not None:
        raise UserError(problem)


def window_problem() -> str | None:
    """Why Qt cannot open a window here; None if it can."""
    try:
        import PySide6  # noqa: F401
    except ImportError:
        return "the window needs Qt: pip install 'foveated-hybrid-renderer[demo]'"
    displays = ("QT_QPA_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(os.environ.get(name) for name in displays):
        return "there is no display; set DISPLAY, or use --browser"
    ended = tried()
    if ended.returncode:
        lines = [line.strip() for line in ended.stderr.splitlines() if line.strip()]
        said = lines[0] if lines else f"it ended with code {ended.returncode}"
        return f"Qt cannot open a window here ({said}); on Debian: apt install {_LIBRARIES}"
    return None


def tried(environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Lets another process connect to the display, in this environment by default; returns how it ended."""
    trial = [sys.executable, "-c", "from PySide6.QtWidgets import QApplication; QApplication([])"]
    return subprocess.run(trial, env=environment, capture_output=True, text=True, check=False)
