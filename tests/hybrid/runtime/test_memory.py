"""Memory that is no longer used goes back to the operating system."""

from __future__ import annotations

import os
from pathlib import Path

import drjit as dr
import mitsuba as mi
import pytest

from hybrid.runtime.memory import release_memory

_BYTES = 128 << 20


def resident() -> int:
    """Bytes of this process in memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def test_memory_of_dropped_arrays_is_released(backend):
    if backend.llvm is None:
        pytest.skip("arrays of the CUDA backend are not in the memory of the process")
    release_memory()
    before = resident()
    array = dr.arange(mi.Float, _BYTES // 4) + 1
    dr.eval(array)
    dr.sync_thread()
    assert resident() > before + _BYTES // 2
    del array
    assert resident() > before + _BYTES // 2
    release_memory()
    assert resident() < before + _BYTES // 4
