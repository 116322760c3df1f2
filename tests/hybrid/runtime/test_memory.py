"""Memory that is no longer used goes back to the operating system."""

from __future__ import annotations

import os

import drjit as dr
import mitsuba as mi
import pytest

from hybrid.runtime.memory import release_memory

_BYTES = 128 << 20


def resident_memory() -> int:
    """Bytes of the process that are in memory now (Linux)."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_memory_of_dropped_arrays_is_released(backend):
    if backend.llvm is None:
        pytest.skip("arrays of the CUDA backend are not in the memory of the process")
    release_memory()
    before = resident_memory()
    array = dr.arange(mi.Float, _BYTES // 4) + 1
    dr.eval(array)
    dr.sync_thread()
    assert resident_memory() > before + _BYTES // 2
    del array
    assert resident_memory() > before + _BYTES // 2
    release_memory()
    assert resident_memory() < before + _BYTES // 4
