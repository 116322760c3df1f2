"""A hybrid frame against the full path-traced one and its disc."""

from __future__ import annotations

import time

import pytest

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode
from hybrid.evaluation import quickstart as comparison
from hybrid.evaluation.methods import FullTrace
from hybrid.evaluation.quickstart import compare
from hybrid.render.frame_settings import FrameSettings


def ignore(done: int, total: int) -> None:
    """No progress."""


def test_each_frame_has_a_camera_of_its_own(renderer, monkeypatch):
    asked = []
    for name in ("frame", "disc_alone"):
        make = getattr(renderer, name)
        monkeypatch.setattr(
            renderer,
            name,
            lambda settings, seed, make=make: (asked.append(settings.camera.key), make(settings, seed)),
        )
    trace = FullTrace.render
    monkeypatch.setattr(
        FullTrace,
        "render",
        lambda self, view, *rest: (asked.append(view.camera.key), trace(self, view, *rest)),
    )
    settings = FrameSettings(fov_a=60, fov_b=40, spp=1)
    row = compare(renderer, [View(renderer.scene.camera.resized(48, 32))], settings, 3, 1, ignore)
    assert len(asked) == len(set(asked)) == 3 * (3 + 1)
    assert row["covered"] == pytest.approx(0.69, abs=0.01)


@pytest.mark.parametrize("mode", list(FoveaMode))
def test_the_full_frame_is_denoised_where_the_disc_is(renderer, monkeypatch, mode):
    made = []

    def recorded(tracer, spp, denoised):
        made.append((spp, denoised))
        return FullTrace(tracer, spp, denoised)

    monkeypatch.setattr(comparison, "FullTrace", recorded)
    camera = renderer.scene.camera.resized(32, 32)
    compare(renderer, [View(camera)], FrameSettings(fovea=mode, spp=2, fov_a=30, fov_b=10), 3, 1, ignore)
    assert made == [(2, mode is not FoveaMode.RAW)]


def test_times_of_methods_are_told_apart():
    """Sleeping takes at least as long as asked."""
    slow, quick = lambda gaze, seed: time.sleep(0.02), lambda gaze, seed: None
    times = [[comparison._timed(method, Gaze(), 0)["total"] for _ in range(3)] for method in (slow, quick)]
    assert min(times[0]) >= 20 > min(times[1])


def test_ratios_are_those_of_the_medians(renderer, monkeypatch):
    """Path tracing takes 30 ms, hybrid frames 10, their discs 6."""
    times = [[10.0, 9, 11], [30.0, 90, 3], [6.0, 6, 6]]
    found = [[{"total": frame} for frame in frames] for frames in times]
    monkeypatch.setattr(comparison, "interleaved_passes", lambda methods, *_: found)
    row = compare(renderer, [View(renderer.scene.camera)], FrameSettings(), 3, 1, ignore)
    assert (row["ratio"], row["ceiling"]) == (3.0, 5.0)
    assert row["path_traced_ms"]["p50"] == 30
