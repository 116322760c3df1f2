"""What the command line shows on standard error: progress bars with the time left, and messages as lines.

Standard output holds results only.
"""

from __future__ import annotations

import logging
import threading
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


# Between two lines where no bar can be drawn, in seconds; and when the last one was written, for any job.
_LINE_EVERY = 10.0
_last = time.perf_counter()


@contextmanager
def progress_bar(title: str) -> Iterator[Bar]:
    """A progress bar for one job, with the elapsed time and the time left; a line now and then in a file."""
    # Colours may be forced into a file, or a terminal know no control sequences: bars need one that does.
    if console.is_dumb_terminal or not console.file.isatty():
        with _lines(title) as lines:
            yield lines
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


@contextmanager
def _lines(title: str) -> Iterator[Bar]:
    """Writes a line after each while, also where a step takes longer."""
    start, shown, is_over = time.perf_counter(), (0, 0, ""), threading.Event()

    def bar(done: int, total: int, step: str = "") -> None:
        nonlocal shown
        shown = done, total, step

    def write() -> None:
        global _last
        while not is_over.wait(max(0.0, _last + _LINE_EVERY - time.perf_counter())):
            _last = time.perf_counter()
            console.print(_line(title, *shown, _last - start), soft_wrap=True, markup=False)

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    try:
        yield bar
    finally:
        is_over.set()
        writer.join()


def _line(title: str, done: int, total: int, step: str, seconds: float) -> str:
    """What is being done, how far it is after some seconds, and how many are left if anybody can tell."""
    parts = [f"{done} of {total}"] * bool(total) + [f"{seconds:.0f} s"]
    if 0 < done <= total:
        parts.append(f"about {seconds * (total - done) / done:.0f} s left")
    return f"{title} {step}".rstrip() + ": " + ", ".join(parts)
