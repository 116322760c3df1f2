"""Long work: what tells how far it is, and Ctrl-C between two steps."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, TypeAlias

# Called with steps done and steps in total.
Steps: TypeAlias = Callable[[int, int], None]
# The same with what is being done, such as "stage 1: frames (samples)". Each part of a job counts its own
# steps, unless it is said that the job counts as a whole.
Progress: TypeAlias = Callable[[int, int, str], None]


class Bar(Protocol):
    """Shows the progress of a part of a job."""

    def __call__(self, done: int, total: int, step: str = "") -> None:
        """Shows that `done` of `total` steps are complete and, optionally, which kind of step comes next."""


# Makes a bar for a part with the given title.
Bars: TypeAlias = Callable[[str], AbstractContextManager[Bar]]


def no_progress(done: int, total: int, step: str = "") -> None:
    """Ignores progress."""


def bars_of(progress: Progress) -> Bars:
    """Bars that report to a callback, with their titles as labels."""

    @contextmanager
    def bars(title: str) -> Iterator[Bar]:
        yield lambda done, total, step="": progress(done, total, f"{title} {step}".rstrip())

    return bars


no_bars = bars_of(no_progress)


@contextmanager
def interrupts_between_steps() -> Iterator[Callable[[], None]]:
    """Delays Ctrl-C until a step is complete, because no work can resume from the middle of a step.

    Yields a function to call between steps; it raises KeyboardInterrupt if Ctrl-C was pressed.
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
