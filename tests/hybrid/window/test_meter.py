"""Times between frames and from the gaze to the screen, as lines and as figures; the bench."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import pytest

from hybrid.window import meter as module
from hybrid.window.messages import ShownView
from hybrid.window.meter import Meter, WindowBench, figures, lines_of, steadiness, summary
from tests.hybrid.window.fakes import REQUEST, shown


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


def test_the_first_frame_has_no_interval_yet():
    assert lines_of(shown(), Meter()) == [
        "trace 20 splat 10 total 30 ms",
        "6,789 paths, 12,345 Gaussians",
        "2.5 samples per pixel in the disc",
        "fov-a 15.0 %, fov-b 11.2 %, 1 spp, 320 x 240, fovvideovdp",
    ]


def test_times_are_medians_of_the_shown_frames():
    meter = Meter()
    for at in (0.0, 0.03, 0.07, 0.12):
        meter.moved(at - 0.06)
        meter.shown(at, at, {})
    assert lines_of(shown(), meter)[:2] == ["frame 40 ms (p95 49), 25.0 FPS", "mouse to screen 60 ms"]


def test_a_path_traced_frame_shows_its_samples():
    lines = lines_of(shown(replace(REQUEST, view=ShownView.SPLIT), path_traced_spp=24), Meter())
    assert lines[3] == "24 samples per pixel in the path-traced frame"


def test_a_target_shows_what_was_chosen_for_it():
    settings = replace(REQUEST.settings, layers=(1, 2), rate=1)
    lines = lines_of(shown(replace(REQUEST, settings=settings, target_fps=15.0)), Meter())
    assert lines[-1] == "chosen for 15 FPS: finest layer 2, at most 1 sample per 2 x 2 px"
    unlimited = replace(REQUEST.settings, layers=None)
    lines = lines_of(shown(replace(REQUEST, settings=unlimited, target_fps=24.5)), Meter())
    assert lines[-1] == "chosen for 24.5 FPS: finest layer 3, at most 1 sample per 1 x 1 px"


def test_what_there_is_to_say_comes_first():
    lines = lines_of(replace(shown(), notice="not connected: refused"), Meter())
    assert lines == ["not connected: refused", *lines_of(shown(), Meter())]


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


class Process:
    """A process that ends when the test says so."""

    started: ClassVar[list[list[str]]] = []
    ended: ClassVar[bool] = False

    def __init__(self, command: list[str]):
        self.started.append(command)

    def poll(self) -> int | None:
        return 0 if self.ended else None


@pytest.fixture
def process(monkeypatch) -> type[Process]:
    monkeypatch.setattr(Process, "started", [])
    monkeypatch.setattr(Process, "ended", False)
    monkeypatch.setattr(module, "subprocess", SimpleNamespace(Popen=Process))
    return Process


def test_it_is_over_after_warm_up_and_its_seconds():
    bench = WindowBench(10.0)
    assert not bench.is_over(1e9)
    bench.begin(100.0)
    assert bench.start == 104.0
    assert not bench.is_over(113.9)
    assert bench.is_over(114.1)
    assert bench.loaded is None


def test_the_mouse_follows_a_curve():
    bench = WindowBench(10.0)
    bench.begin(100.0)
    for now, x, y in ((100.0, 0.5, 0.5), (101.0, 0.712, 0.8), (102.0, 0.8, 0.5), (108.0, 0.5, 0.5)):
        gaze = bench.gaze(now)
        assert (gaze.x, gaze.y) == pytest.approx((x, y), abs=5e-3)


def test_a_load_runs_once_in_the_middle_and_is_timed(process):
    bench = WindowBench(10.0, load=2.0)
    bench.begin(100.0)
    # Four seconds of warm-up, then ten of which the middle two are loaded.
    bench.is_over(107.9)
    assert not process.started
    for now in (108.1, 109.0, 110.0):
        bench.is_over(now)
    assert [command[-1] for command in process.started] == ["2.0"]
    assert bench.loaded is None
    process.ended = True
    for now in (110.2, 111.0):
        bench.is_over(now)
    assert bench.loaded == pytest.approx((4.1, 6.2))
    assert len(process.started) == 1
