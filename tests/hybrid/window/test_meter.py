"""Times between frames, and from the gaze to the screen."""

from __future__ import annotations

import pytest

from hybrid.window.meter import Meter


def test_latency_counts_to_the_first_frame_that_includes_a_movement():
    meter = Meter()
    for at in (0.00, 0.01, 0.02):
        meter.moved(at)
    meter.shown(0.07, gaze_time=0.01, passes={"trace": 5.0})
    meter.shown(0.13, gaze_time=0.02, passes={"trace": 6.0})
    meter.shown(0.20, gaze_time=0.02, passes={})
    assert [seconds for _, seconds in meter.latencies] == pytest.approx([0.07, 0.06, 0.11])
    assert [at for at, _ in meter.latencies] == [0.07, 0.07, 0.13]
    assert [seconds for _, seconds in meter.intervals] == pytest.approx([0.06, 0.07])
    assert [at for at, _ in meter.intervals] == [0.13, 0.20]
    assert list(meter.passes) == [{"trace": 5.0}, {"trace": 6.0}, {}]


def test_only_recent_frames_are_kept_unless_all_are_wanted():
    meters = Meter(), Meter(keeps_all=True)
    for meter in meters:
        for number in range(1000):
            meter.moved(number)
            meter.shown(number + 0.5, number, {})
    assert [len(meter.intervals) for meter in meters] == [100, 999]
    assert [len(meter.latencies) for meter in meters] == [100, 1000]
    assert [len(meter.passes) for meter in meters] == [100, 1000]
    assert meters[0].intervals[-1][0] == 999.5


def test_movements_without_a_frame_take_bounded_memory():
    meter = Meter(keeps_all=True)
    for number in range(5000):
        meter.moved(number)
    meter.shown(5000, 5000, {})
    assert len(meter.latencies) == 1000
    assert meter.latencies[-1][1] == 1


def test_a_pause_counts_neither_as_a_frame_nor_as_latency():
    meter = Meter()
    meter.shown(1.0, 1.0, {})
    meter.moved(1.5)
    meter.pause()
    meter.shown(30.0, 30.0, {})
    meter.moved(30.1)
    meter.shown(30.2, 30.1, {})
    assert [seconds for _, seconds in meter.intervals] == pytest.approx([0.2])
    assert [seconds for _, seconds in meter.latencies] == pytest.approx([0.1])
