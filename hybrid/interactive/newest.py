"""A slot that hands the newest item from thread to thread."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """Holds one item; a newer one replaces it, whether or not it was taken."""

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        self._item: T | None = None

    def put(self, item: T) -> None:
        """Puts an item into the slot; never waits."""
        with self._arrived:
            self._item = item
            self._arrived.notify()

    def take(self, timeout: float = 0.0) -> T | None:
        """Takes the newest item out of the slot; None if it is still empty after `timeout` seconds."""
        with self._arrived:
            if self._item is None:
                self._arrived.wait(timeout)
            item, self._item = self._item, None
            return item
