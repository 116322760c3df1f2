"""The device: its arrays, clock, threads and memory."""

from __future__ import annotations

import time

import drjit as dr
import mitsuba as mi
import pytest

from hybrid.base.compute_device import PassClock, device_arrays, release_memory
from pathtrace.scene import backend as backend_module
from tests.small import resident_memory

pytestmark = pytest.mark.usefixtures("backend")


@pytest.mark.parametrize(("variant", "expected"), [("llvm_ad_rgb", "llvm"), ("cuda_ad_rgb", "cuda")])
def test_arrays_are_those_of_mitsubas_variant(variant, expected, monkeypatch):
    monkeypatch.setattr(mi, "variant", lambda: variant)
    monkeypatch.setattr(backend_module, "_selected", None)
    arrays = device_arrays()
    assert arrays.backend == expected
    assert arrays.plain.__name__ == f"drjit.{expected}"


@pytest.fixture
def at(monkeypatch):
    """Sets the time in seconds; work on the device that is waited for takes a tenth of a second."""
    now = [0.0]

    def wait() -> None:
        now[0] += 0.1

    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(dr, "sync_thread", wait)
    return lambda seconds: now.__setitem__(0, seconds)


def test_passes_are_measured_one_after_the_other_until_the_device_is_done(at):
    at(5.0)
    clock = PassClock()
    at(5.2)
    clock.lap("trace")
    at(5.8)
    clock.lap("blend")
    at(9.0)
    assert clock.milliseconds() == pytest.approx({"trace": 300, "blend": 600, "total": 900})


def test_a_clock_without_passes_has_measured_nothing(at):
    clock = PassClock()
    at(1.0)
    assert clock.milliseconds() == {"total": 0}


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
