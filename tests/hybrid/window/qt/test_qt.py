"""What is missing for a window is said in one line, before Qt ends the process."""

from __future__ import annotations

import subprocess
import sys

import pytest

from compose.base.errors import UserError
from hybrid.window import qt_check as qt
from hybrid.window.qt_check import require_window, tried
from tests.hybrid.command import run


@pytest.fixture
def no_display(monkeypatch) -> None:
    pytest.importorskip("PySide6", reason="the window needs Qt")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)


def trial(monkeypatch: pytest.MonkeyPatch, code: int, stderr: str) -> None:
    """Lets Qt's display be tried with this outcome."""
    monkeypatch.setattr(qt, "tried", lambda: subprocess.CompletedProcess([], code, "", stderr))


def test_qt_that_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "PySide6", None)
    with pytest.raises(UserError, match=r"pip install 'foveated-hybrid-renderer\[demo\]'"):
        require_window()


@pytest.mark.parametrize("name", ["DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"])
def test_any_kind_of_display_will_do(no_display, monkeypatch, name):
    monkeypatch.setenv(name, "some")
    trial(monkeypatch, 0, "")
    require_window()


@pytest.mark.parametrize(
    ("stderr", "said"), [("\nfirst reason\nsecond\n", "(first reason)"), ("", "(it ended with code 3)")]
)
def test_a_display_that_qt_cannot_use(no_display, monkeypatch, stderr, said):
    monkeypatch.setenv("DISPLAY", ":99")
    trial(monkeypatch, 3, stderr)
    with pytest.raises(UserError) as raised:
        require_window()
    assert said in str(raised.value)
    assert "apt install libxcb-cursor0" in str(raised.value)


def test_a_trial_opens_a_window_in_memory(offscreen):
    assert tried(offscreen).returncode == 0


@pytest.mark.parametrize("platform", [None, "nothing-of-that-name"])
def test_the_command_serves_the_window_to_a_browser_instead(
    no_display, monkeypatch, capsys, tmp_path, platform
):
    served = []
    monkeypatch.setattr("hybrid.window.browser.serve_window", lambda *given: served.append(given))
    if platform is not None:
        monkeypatch.setenv("QT_QPA_PLATFORM", platform)
    assert run(monkeypatch, "demo", "cornell", "--out", tmp_path) == 0
    assert len(served) == 1
    said = capsys.readouterr().out.strip()
    assert said.startswith("in a browser, since ")
    assert "\n" not in said


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux may have no display")
def test_what_needs_qt_says_so_in_one_line(no_display):
    with pytest.raises(UserError, match="there is no display; set DISPLAY, or use --browser"):
        require_window()
