"""Progress bars: title, step and count on standard error."""

from __future__ import annotations

import io
import logging
import re
import time

import pytest
from rich.console import Console

from hybrid.cli import progress
from hybrid.cli.progress import progress_bar


class Screen(io.StringIO):
    """What a terminal shows."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def shown(monkeypatch):
    """What the bar writes to a terminal."""
    screen = Screen()
    monkeypatch.setattr(progress, "console", Console(file=screen, force_terminal=True, width=120))
    return screen


def test_a_bar_shows_title_step_and_count(shown):
    with progress_bar("capture") as bar:
        bar(3, 12, "denoising")
    assert "capture denoising" in shown.getvalue()
    assert "3/12" in shown.getvalue()


def test_a_step_is_not_shown_once_it_is_over(shown):
    with progress_bar("capture") as bar:
        bar(3, 12, "denoising")
        bar(4, 12)
    last = shown.getvalue().rsplit("capture", 1)[1]
    assert "4/12" in last
    assert "denoising" not in last


def test_results_and_bars_do_not_mix(capsys):
    progress.console.print("a bar")
    assert progress.console.stderr
    assert capsys.readouterr().out == ""


def test_messages_are_lines_while_a_command_runs(capsys):
    log = logging.getLogger("hybrid")
    with progress.messages_as_lines():
        log.info("[%d] thin_glass lets them pass " + 30 * "and pass ", 3)
    log.info("afterwards")
    said = capsys.readouterr().err
    assert said.startswith("[3] --thin-glass lets them pass and")
    assert said.count("\n") == 1


@pytest.mark.parametrize("where", ["file", "file of a log with colours", "dumb terminal"])
def test_where_no_bar_can_be_drawn_there_is_a_line_now_and_then(monkeypatch, where):
    """Even if a step takes so long that nobody calls the bar meanwhile."""
    screen = Screen() if where == "dumb terminal" else io.StringIO()
    how = {"FORCE_COLOR": "1"} if "colours" in where else {"TERM": "dumb"}
    console = Console(file=screen, width=40, _environ={} if where == "file" else how, no_color=True)
    monkeypatch.setattr(progress, "console", console)
    monkeypatch.setattr(progress, "_LINE_EVERY", 0.001)
    with progress_bar("capture (samples)") as bar:
        for done, step in ((4, ""), (5, "denoising")):
            bar(done, 10, step)
            before = screen.tell()
            # The next line may be one that was under way.
            while screen.getvalue()[before:].count("left\n") < 2:
                time.sleep(0.001)
    lines = re.sub("\x1b\\[[0-9;]*m", "", screen.getvalue()).splitlines()
    assert "capture (samples): 4 of 10, 0 s, about 0 s left" in lines
    assert lines[-1] == "capture (samples) denoising: 5 of 10, 0 s, about 0 s left"


@pytest.mark.parametrize(
    ("how_far", "expected"),
    [
        ((0, 0, ""), "plan: 20 s"),
        ((0, 8, "choosing views"), "plan choosing views: 0 of 8, 20 s"),
        ((4, 10, ""), "plan: 4 of 10, 20 s, about 30 s left"),
        ((10, 10, ""), "plan: 10 of 10, 20 s, about 0 s left"),
    ],
)
def test_a_line_tells_what_is_known(how_far, expected):
    assert progress._line("plan", *how_far, 20.0) == expected
