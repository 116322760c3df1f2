"""What the command line shows on standard error: progress bars with the time left, and messages as lines.

Standard output holds results only.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from hybrid.base.progress import Bar

console = Console(stderr=True)
# What messages suggest, by settings and by options.
_OPTIONS = {
    "thin_glass lets": "--thin-glass lets",
    "most_indirect bounds": "--clamp-indirect of `hybrid prepare` bounds",
}


class _Lines(logging.Handler):
    """Writes each message as a line, above the progress bar if there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        message = record.getMessage()
        for setting, option in _OPTIONS.items():
            message = message.replace(setting, option)
        console.print(message, soft_wrap=True, markup=False)


@contextmanager
def messages_as_lines() -> Iterator[None]:
    """Shows what the packages log while a command runs."""
    log, handler = logging.getLogger("hybrid"), _Lines()
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


# Between two lines where no bar can be drawn, in seconds.
_LINE_EVERY = 15.0


@contextmanager
def progress_bar(title: str) -> Iterator[Bar]:
    """A progress bar for one job, with the elapsed time and the time left; a line now and then in a file."""
    # Colours may be forced into a file, or a terminal know no control sequences: bars need one that does.
    if console.is_dumb_terminal or not console.file.isatty():
        yield _lines(title)
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total, step="": bar.update(
            task, completed=done, total=total, description=f"{title} {step}".rstrip()
        )


def _lines(title: str) -> Bar:
    """Writes a line when some time has passed since the last one."""
    start = last = time.perf_counter()

    def bar(done: int, total: int, step: str = "") -> None:
        nonlocal last
        now = time.perf_counter()
        if now - last < _LINE_EVERY or not done:
            return
        last = now
        left = (now - start) * max(0, total - done) / done
        job = f"{title} {step}".rstrip()
        console.print(
            f"{job}: {done} of {total}, {now - start:.0f} s, about {left:.0f} s left", soft_wrap=True
        )

    return bar
