"""The device that computes frames: its arrays and memory, and times of passes."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi

from compose.base.arrays import Arrays
from pathtrace.scene.backend import require_backend


def device_arrays() -> Arrays:
    """Array types of the selected backend; requires that this process has called `select_backend`."""
    require_backend()
    return Arrays("cuda" if str(mi.variant()).startswith("cuda") else "llvm")


class PassClock:
    """Measures consecutive passes.

    On the CPU, a pass ends when its kernels have finished. On a card, which is to work on one pass while the
    host prepares the next, a pass is what the host does for it, and "device" what it waits for in the end.
    """

    def __init__(self) -> None:
        self._waits = device_arrays().backend == "llvm"
        self._start = self._last = time.perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """Ends a pass."""
        if self._waits:
            dr.sync_thread()
        self._note(name)

    def milliseconds(self, before: Mapping[str, float] | None = None) -> dict[str, float]:
        """Milliseconds of each pass, and of all passes together ("total"), when all have finished.

        Those of passes `before`, which another clock has measured, are part of them.
        """
        if not self._waits:
            dr.sync_thread()
            self._note("device")
        earlier = {} if before is None else dict(before)
        total = earlier.pop("total", 0.0) + (self._last - self._start) * 1000
        return {**earlier, **self._laps, "total": total}

    def _note(self, name: str) -> None:
        now = time.perf_counter()
        self._laps[name] = (now - self._last) * 1000
        self._last = now


class SpareMemory:
    """Releases what frames of other sizes and kinds needed, now and then."""

    # Seconds between two releases, each of which takes three to six milliseconds.
    _EVERY = 2.0

    def __init__(self) -> None:
        self._released = time.monotonic()

    def release(self) -> None:
        """Releases it, unless that was done a moment ago."""
        if time.monotonic() - self._released > self._EVERY:
            release_memory()
            self._released = time.monotonic()


def release_memory() -> None:
    """Releases, in a few milliseconds, the memory that Dr.Jit and the C library keep for reuse."""
    dr.flush_malloc_cache()
    # Specific to glibc; other C libraries release memory by themselves.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
