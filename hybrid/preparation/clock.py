"""The time that a preparation takes, over all of its runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from hybrid.store.journal import Journal

_KEY = "seconds"


class Clock:
    """Counts the seconds of a job.

    Args:
        journal: of the job; has the seconds of earlier runs.
        start: time.perf_counter() at which this run began.
    """

    def __init__(self, journal: Journal, start: float):
        self._journal, self._since = journal, start
        self._spent: float = journal.once(_KEY, lambda: 0.0)

    def seconds(self) -> float:
        """Seconds that count so far."""
        return self._spent + time.perf_counter() - self._since

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Within it, no time counts."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._since += time.perf_counter() - start

    def keep(self) -> None:
        """Writes the seconds down, for the next run."""
        self._journal[_KEY] = self.seconds()
