"""Frames on time: what is asked for again gets better, and a target is kept under load."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.interactive.loop import FrameLoop
from hybrid.interactive.request import Request, Settings, Shows
from hybrid.plan.controller import Rung

CAMERA = Camera(np.eye(4), 64, 48, 50.0, 50.0, 32.0, 24.0)
LADDER = [Rung(5.0 * n, 1, 4, 0, 1.0, 10.0 * n, n) for n in range(1, 7)]


class Source:
    """Frames that take as long as their radius says, times the machine's load."""

    def __init__(self, clock: list[float]):
        self.clock, self.load, self.calls = clock, 1.0, []

    def show(self, request: Request, patient: bool) -> SimpleNamespace:
        self.clock[0] += 2e-3 * request.settings.fov_a * self.load
        self.calls.append((request, patient))
        return SimpleNamespace(request=request, finished=len(self.calls) > 1000)


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    return now


def request(x: float = 0.5, **settings: float) -> Request:
    return Request(CAMERA, Gaze(x, 0.5), Settings(**settings), Shows.COMPOSITE, 0.0)  # type: ignore[arg-type]


def test_without_a_target_settings_are_those_that_were_asked_for(clock):
    source = Source(clock)
    loop = FrameLoop(source, lambda like: LADDER)  # type: ignore[arg-type]
    asked = request(fov_a=30.0)
    loop.make(asked)
    assert source.calls[0][0].settings == asked.settings
    assert loop.due <= clock[0]
    assert not loop.idle


def test_frames_take_their_time_only_after_a_while_without_change(clock):
    source = Source(clock)
    loop = FrameLoop(source, lambda like: LADDER)  # type: ignore[arg-type]
    for _ in range(20):
        loop.make(request(fov_a=50.0))
    patient = [patient for _, patient in source.calls]
    assert not any(patient[:10])
    assert all(patient[12:])
    loop.make(request(x=0.6, fov_a=50.0))
    assert not source.calls[-1][1]


def test_the_same_frame_keeps_its_settings_while_the_controller_learns(clock):
    source = Source(clock)
    loop = FrameLoop(source, lambda like: LADDER)  # type: ignore[arg-type]
    for x in (0.1, 0.2, 0.3, 0.3, 0.3):
        source.load = 1 + x
        loop.make(request(x, target_fps=25.0))
    used = [call.settings for call, _ in source.calls]
    assert used[2] == used[3] == used[4]


def test_a_target_is_kept_and_a_load_is_over_two_seconds_after_it(clock):
    source = Source(clock)
    loop = FrameLoop(source, lambda like: LADDER)  # type: ignore[arg-type]
    rng, shown = np.random.default_rng(1), []
    for number in range(600):
        clock[0] = max(clock[0], loop.due)
        heavy = 104 <= clock[0] < 109
        source.load = (1.9 if heavy else 1.0) * rng.normal(1, 0.05)
        loop.make(request(number / 600, target_fps=15.0))
        shown.append(clock[0])
    at, took = np.array(shown[1:]), np.diff(shown)
    quiet = (at > 101) & ((at < 104) | (at > 111))
    assert np.mean(np.abs(took[quiet] * 15 - 1) < 0.2) > 0.95
    assert np.median(took[(at > 105) & (at < 109)]) == pytest.approx(1 / 15, rel=0.2)


def test_another_size_is_measured_anew_and_another_target_is_not(clock):
    measured = []
    loop = FrameLoop(Source(clock), lambda like: measured.append(like) or LADDER)  # type: ignore[arg-type]
    loop.make(request(0.1, target_fps=15.0))
    loop.make(request(0.2, target_fps=30.0))
    assert len(measured) == 1
    loop.make(replace(request(0.3, target_fps=30.0), camera=CAMERA.resized(100, 80)))
    assert len(measured) == 2
