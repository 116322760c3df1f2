"""Memory of the process: how much it has, and how unused memory returns to the operating system."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

import drjit as dr


def release_memory() -> None:
    """Releases the memory that Dr.Jit and the C library keep for reuse.

    This takes a few milliseconds, and about as many again when the memory is next needed.
    """
    dr.flush_malloc_cache()
    # Specific to glibc; other C libraries release memory by themselves.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def resident_memory() -> int:
    """Bytes of the process that are in memory now (Linux)."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def peak_memory() -> int:
    """Most bytes of the process that were in memory at a time (Linux).

    getrusage would include those of the process that spawned it.
    """
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024


def reset_peak() -> None:
    """Lets `peak_memory` count from now on (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")
