"""Times of the passes of a frame."""

from __future__ import annotations

import time

import drjit as dr
import pytest

from hybrid.base.compute_device import PassClock


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
