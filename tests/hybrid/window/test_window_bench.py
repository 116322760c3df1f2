"""What a bench of the window does with its seconds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import ClassVar

import pytest

from hybrid.window import meter as module
from hybrid.window.meter import WindowBench


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
