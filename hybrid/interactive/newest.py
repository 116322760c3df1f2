"""A place for one thing, handed from thread to thread: the newest wins."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """What is put in replaces what was there; who takes gets the newest, or waits for it."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._item: T | None = None
        self._fresh = False

    def put(self, item: T) -> None:
        """Never waits."""
        with self._changed:
            self._item, self._fresh = item, True
            self._changed.notify()

    def take(self, timeout: float) -> tuple[T | None, bool]:
        """The newest item, None before the first one, and whether it has come since it was last taken.

        Waits for so many seconds at most if it has not.
        """
        with self._changed:
            if not self._fresh:
                self._changed.wait(timeout)
            fresh, self._fresh = self._fresh, False
            return self._item, fresh
