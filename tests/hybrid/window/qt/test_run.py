"""The window as the command runs it, from opening to closing, with a renderer that answers at once."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)

from PySide6.QtCore import QTimer

from compose.base.errors import UserError
from compose.eye.gaze import Gaze, GazeTrace
from hybrid.evaluation.measured_settings import MeasuredSettings
from hybrid.render.frame_settings import INTERACTIVE
from hybrid.window import main_window, viewer
from hybrid.window.learning import ShownScene
from hybrid.window.main_window import run_window
from hybrid.window.viewer import WindowOptions, viewer_of
from tests.hybrid.window.fakes import Source

BOX, FOREST = ShownScene("box"), Path("some.forest")


def measured(*arguments: Any) -> tuple[dict[str, Any], str]:
    """What a window measures until it is closed."""
    opened = viewer_of(*arguments)
    run_window(opened)
    return opened.measured()


@pytest.fixture(autouse=True)
def one_application(application, monkeypatch) -> Iterator[None]:
    """The application of this process, since there can be only one; Ctrl-C as it was."""
    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(main_window, "QApplication", lambda arguments: application)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def source(monkeypatch, backend) -> Source:
    """What is prepared; with a short warm-up."""
    source = Source()

    def prepared(*given: object) -> Source:
        assert given[:4] == (BOX, FOREST, True, INTERACTIVE)
        return source

    monkeypatch.setattr(viewer, "prepared", prepared)
    monkeypatch.setattr("hybrid.window.meter.WARM_UP", 0.3)
    return source


def test_a_bench_moves_the_mouse_and_measures(source, tmp_path):
    options = WindowOptions((320, 240), 0.0, tmp_path, bench=0.5)
    found, summary = measured(BOX, FOREST, INTERACTIVE, None, options)
    assert (found["width"], found["height"]) == (320, 240)
    assert found["fps"] > 0
    assert found["latency_ms"]["p50"] > 0
    assert "target" not in found
    assert summary.startswith(f"{found['fps']:.1f} FPS")
    gazes = {request.settings.gaze for request in source.requests}
    assert len(gazes) > 5
    # All frames are kept, and those of the warm-up are not counted.
    assert 0 < len(found["frames"]) < len(source.requests)
    assert all(at > 0 for at, _ in found["frames"])


def test_a_late_trace_a_target_and_a_load_are_measured(source, monkeypatch, tmp_path):
    ladder = [MeasuredSettings(replace(INTERACTIVE, layers=(1, 3)), 5.0, 9.0)]
    monkeypatch.setattr("hybrid.window.render_thread.ladder_for", lambda source, request, report: ladder)
    here, there = Gaze(0.1, 0.1), Gaze(0.9, 0.9)
    options = WindowOptions((320, 240), 0.2, tmp_path, target_fps=50.0, bench=2.0, load=0.3)
    trace = GazeTrace((0.0, 0.1, 0.2), (here, there, there))
    found, _ = measured(BOX, FOREST, INTERACTIVE, trace, options)
    assert {request.settings.gaze for request in source.requests} == {here, there}
    assert (found["target"]["fps"], found["target"]["tolerance"]) == (50, 0.2)
    begin, end = found["target"]["loaded_s"]
    assert begin > 0.5
    assert end - begin >= 0.3
    # The gaze that a frame shows is at least as old as the tracker is late.
    assert found["latency_ms"]["p50"] > 200


def test_what_ends_the_renderer_is_raised(application, monkeypatch, tmp_path):
    def fails(*arguments: object, **options: object) -> Source:
        raise UserError("no-such-scene: there is no such scene")

    monkeypatch.setattr(viewer, "prepared", fails)
    options = WindowOptions((320, 240), 0.0, tmp_path)
    with pytest.raises(UserError, match="no such scene"):
        measured(BOX, None, INTERACTIVE, None, options)


def test_ctrl_c_closes_the_window(source, tmp_path):
    QTimer.singleShot(300, lambda: signal.raise_signal(signal.SIGINT))
    options = WindowOptions((320, 240), 0.0, tmp_path, bench=3600.0)
    found, _ = measured(BOX, FOREST, INTERACTIVE, None, options)
    assert "frames" in found
