"""The device that computes frames: its arrays and memory, and times of passes."""

from __future__ import annotations

import ctypes
import time

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

    def milliseconds(self) -> dict[str, float]:
        """Milliseconds of each pass, and of all passes together ("total"), when all have finished."""
        if not self._waits:
            dr.sync_thread()
            self._note("device")
        return {**self._laps, "total": (self._last - self._start) * 1000}

    def _note(self, name: str) -> None:
        now = time.perf_counter()
        self._laps[name] = (now - self._last) * 1000
        self._last = now


def release_memory() -> None:
    """Releases, in a few milliseconds, the memory that Dr.Jit and the C library keep for reuse."""
    dr.flush_malloc_cache()
    # Specific to glibc; other C libraries release memory by themselves.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
