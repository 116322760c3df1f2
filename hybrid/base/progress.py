"""Long work on the console: progress bars with the time left, and Ctrl-C between two steps."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, TypeAlias

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

# Bars go to standard error; standard output holds results only.
console = Console(stderr=True)


class Bar(Protocol):
    """Shows the progress of a job."""

    def __call__(self, done: int, total: int, step: str = "") -> None:
        """Shows that `done` of `total` steps are complete and, optionally, which kind of step comes next."""


# Makes a bar for a job with the given title.
Bars: TypeAlias = Callable[[str], AbstractContextManager[Bar]]
# Seconds between two lines where no bar can be drawn.
_LINE_EVERY = 15.0


def no_progress(done: int, total: int, step: str = "") -> None:
    """Ignores progress."""


@contextmanager
def no_bars(title: str) -> Iterator[Bar]:
    """Shows nothing."""
    yield no_progress


@contextmanager
def progress_bar(title: str) -> Iterator[Bar]:
    """A progress bar for one job, with the elapsed time and the time left; a line now and then in a file."""
    if not console.is_terminal:
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


@contextmanager
def interrupts_between_steps() -> Iterator[Callable[[], None]]:
    """Delays Ctrl-C until a step is complete, because no work can resume from the middle of a step.

    Yields:
        A function to call between steps; it raises KeyboardInterrupt if Ctrl-C was pressed.
    """
    pressed = False

    def remember(number: int, frame: object) -> None:
        nonlocal pressed
        pressed = True

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        # Python delivers signals to the main thread only.
        yield check
        return
    before = signal.signal(signal.SIGINT, remember)
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)
