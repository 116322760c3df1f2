"""The text over the frame."""

from __future__ import annotations

from dataclasses import replace

from hybrid.window.messages import ShownView
from hybrid.window.meter import Meter, lines_of
from tests.hybrid.window.fakes import REQUEST, shown


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
