"""Memory that is no longer used goes back to the operating system."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import pytest

from hybrid.base.compute_device import release_memory
from tests.small import resident_memory

_BYTES = 128 << 20


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
