"""Figures of the window: of frames that count, and of how well a target was kept."""

from __future__ import annotations

import pytest

from hybrid.window.meter import Meter, figures, steadiness, summary

# Ten frames a second: two of eight are late before the load, all under it, one of two right after.
FRAMES = [(0.1 * i, 100.0 if i % 4 else 130.0) for i in range(8)]
FRAMES += [(1.0, 150.0), (1.2, 170.0), (1.4, 160.0), (2.0, 119.0), (3.0, 121.0), (4.0, 100.0)]


def test_frames_within_a_fifth_of_the_target_keep_it():
    found = steadiness(FRAMES, 10.0, (0.9, 1.5))
    assert found["kept"] == pytest.approx(7 / 9)
    assert found["kept_after_load"] == pytest.approx(1 / 2)
    assert found["ms_under_load"] == 160
    assert found["loaded_s"] == [0.9, 1.5]
    assert (found["fps"], found["tolerance"]) == (10, 0.2)


def test_early_frames_do_not_keep_the_target_either():
    assert steadiness([(0.0, 81.0), (0.1, 79.0)], 10.0, None)["kept"] == 0.5


def test_without_a_load_all_frames_count():
    alone = steadiness(FRAMES, 10.0, None)
    assert alone["kept"] == pytest.approx(8 / 14)
    assert not {"kept_after_load", "ms_under_load", "loaded_s"} & set(alone)


def test_without_frames_there_is_no_share():
    assert set(steadiness([], 10.0, (1.0, 2.0))) == {"fps", "tolerance"}


def measured() -> Meter:
    """Two frames while kernels are compiled, then three that count, from second 10 on."""
    meter = Meter(keeps_all=True)
    for at, late, passes in (
        (8.0, 0.5, {"trace": 500.0}),
        (9.0, 0.5, {"trace": 500.0}),
        (10.5, 0.1, {"trace": 30.0, "splat": 5.0}),
        (10.54, 0.06, {"trace": 20.0, "splat": 7.0}),
        (10.59, 0.08, {"trace": 25.0}),
    ):
        meter.moved(at - late)
        meter.shown(at, at - late, passes)
    return meter


def test_only_frames_after_the_start_count(backend):
    found = figures(measured(), (320, 240), 10.0)
    assert (found["width"], found["height"]) == (320, 240)
    # Intervals of 1500, 40 and 50 ms.
    assert found["fps"] == pytest.approx(20)
    assert found["ms"]["p50"] == pytest.approx(50)
    assert found["ms"].keys() == {"p50", "p95", "p99"}
    assert found["latency_ms"]["p50"] == pytest.approx(80)
    assert found["passes"] == {"trace": 25, "splat": 6}
    assert [at for at, _ in found["frames"]] == pytest.approx([0.5, 0.54, 0.59])
    assert [ms for _, ms in found["frames"]] == pytest.approx([1500, 40, 50])
    assert found["machine"]["cores"] > 0


def test_without_frames_there_are_no_times(backend):
    found = figures(Meter(), (320, 240), 10.0)
    assert not {"fps", "ms", "latency_ms"} & set(found)
    assert found["passes"] == {}
    assert summary(found) == "no frame was shown"


def test_the_summary_is_one_line_and_another_for_the_target():
    found = {"fps": 24.96, "ms": {"p50": 40.1, "p95": 52.0, "p99": 61.0}}
    assert summary(found) == "25.0 FPS, frames of 40 ms (p95 52, p99 61)"
    found["latency_ms"] = {"p50": 60.0, "p95": 75.0}
    assert summary(found).endswith(", 60 ms from mouse to screen (p95 75)")
    found["target"] = {"fps": 25.0, "kept": 0.973}
    assert summary(found).splitlines()[1] == "97.3% of frames within 20% of 40 ms"
    found["target"] |= {"kept_after_load": 0.933, "ms_under_load": 47.6}
    expected = "97.3% of frames within 20% of 40 ms, 93.3% in the 2 seconds after the load; 48 ms under load"
    assert summary(found).splitlines()[1] == expected
