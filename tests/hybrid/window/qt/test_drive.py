"""The real window on a virtual screen: mouse, keys, sliders, files, and that it ends."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from compose.eye.gaze import load_gaze_trace
from hybrid.window.qt_check import tried
from tests.hybrid.command import run

pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)


@pytest.fixture(scope="module")
def screen() -> Iterator[dict[str, str]]:
    """Environment with a virtual screen; one in memory if Xvfb or Qt's plugin for it is missing."""
    hidden = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    offscreen = environment | {"QT_QPA_PLATFORM": "offscreen"}
    with virtual_screen() as number:
        shown = None if number is None else environment | {"DISPLAY": f":{number}"}
        usable = next((e for e in (shown, offscreen) if e is not None and tried(e).returncode == 0), None)
        if usable is None:
            pytest.skip("Qt can open no window here, not even in memory: its libraries are missing")
        yield usable


@contextmanager
def virtual_screen() -> Iterator[str | None]:
    """The number of a screen that Xvfb draws; None if it is not installed."""
    if shutil.which("Xvfb") is None:
        yield None
        return
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1280x800x24", "-nolisten", "tcp"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert server.stdout is not None
    yield server.stdout.readline().strip()
    server.terminate()
    server.wait()


def driven(scenario: str, screen: dict[str, str], made: Path, out: Path, *more: object) -> dict:
    """What a driver saw of the window; a crash fails here."""
    command = [
        sys.executable,
        "-m",
        "tests.hybrid.window.qt.drive",
        scenario,
        made / "box.forest",
        out,
        *more,
    ]
    # Neither its plan nor its cache is made again.
    shutil.copytree(made / "home", out / "home", ignore=shutil.ignore_patterns("forests", "receipts"))
    home = {"HYBRID_HOME": str(out / "home")}
    ended = subprocess.run(
        [str(part) for part in command], env=screen | home, capture_output=True, text=True, timeout=600
    )
    assert ended.returncode == 0, ended.stderr
    return json.loads((out / "seen.json").read_text())


@pytest.fixture(scope="module")
def toured(screen, made, tmp_path_factory) -> tuple[dict, Path]:
    folder = tmp_path_factory.mktemp("tour")
    return driven("tour", screen, made, folder), folder


def test_the_disc_is_where_the_mouse_is(toured):
    for disc in toured[0]["discs"]:
        assert [disc["x"], disc["y"]] == pytest.approx(disc["mouse"], abs=2)
        # 15 % of 240 pixels, on both sides; the outermost ring is too dark to be visible.
        assert disc["width"] == pytest.approx(72, abs=6)


def test_sliders_and_keys_do_what_they_say(toured):
    seen = toured[0]
    assert seen["wider"] == pytest.approx(144, abs=10)
    # The gaze is held where it was, although the mouse has moved.
    assert [seen["held"]["x"], seen["held"]["y"]] == pytest.approx([160, 120], abs=2)
    assert seen["first"] > 10
    assert len(set(seen["views"].values())) == len(seen["views"])
    assert seen["views"]["FOVEA"] < 0.5 * seen["views"]["COMPOSITE"]
    for name in ("help", "hud", "walked", "dragged"):
        assert seen[name] > 0.5, name
    assert np.linalg.norm(np.subtract(seen["at home"], seen["away"])) > 1e-3


def test_without_controls_the_frame_fills_the_window(toured):
    seen = toured[0]
    assert seen["wide"] > 320
    assert seen["frame"][1] == seen["wide"]


def test_files_hold_the_screenshot_and_the_gaze(toured):
    folder = toured[1]
    assert Image.open(folder / "cornell-001.png").size == (320, 240)
    trace = load_gaze_trace(folder / "cornell-gaze-001.csv")
    assert [gaze.x for gaze in trace.gazes][-3:] == pytest.approx([190 / 320, 200 / 320, 210 / 320], abs=0.01)
    assert 0.1 < trace.duration < 5


def test_every_thread_ends_with_the_window(toured):
    seen = toured[0]
    assert not seen["running"]
    assert seen["threads"] == []
    assert seen["error"] is None


def test_random_input_breaks_nothing(screen, made, tmp_path):
    seen = driven("fuzz", screen, made, tmp_path, 3)
    assert seen["error"] is None
    assert not seen["running"]


def test_a_first_forest_is_trained_while_the_window_responds(screen, made, tmp_path):
    seen = driven("trains", screen, made, tmp_path, 0)
    assert seen["shown"]
    assert seen["error"] is None
    assert {"stage 1: frames (samples)", "stage 1: forest (steps)"} <= set(seen["said"])
    assert seen["pause"] < 2


def test_closing_the_window_stops_the_training(screen, made, tmp_path):
    seen = driven("trains", screen, made, tmp_path, 1)
    assert not seen["shown"]
    assert seen["error"] is None
    assert not seen["running"]


def test_an_error_of_the_renderer_is_one_line_and_exit_code_2(screen, made, tmp_path):
    command = [sys.executable, "-m", "hybrid.cli.main", "demo", "room", "--forest", str(made / "box.forest")]
    home = {"HYBRID_HOME": str(tmp_path)}
    ended = subprocess.run(command, env=screen | home, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 2, ended.stderr
    # In memory, Qt has something to say of its own.
    lines = [line for line in ended.stderr.splitlines() if "This plugin does not support" not in line]
    assert len(lines) == 1
    assert "not to room" in lines[0]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--size", "10", "10"], "--size 10 10"),
        (["--load", "2"], "--load 2.0: must be shorter than --bench"),
        (["--load", "2", "--bench", "2"], "--load 2.0: must be shorter than --bench"),
        (["--gaze-trace", "nowhere.csv"], "nowhere.csv"),
        (["--gaze-trace", "nowhere.csv", "--simulate"], "only come from one of them"),
    ],
)
def test_wrong_options_are_refused_before_the_window_opens(monkeypatch, capsys, tmp_path, options, said):
    assert run(monkeypatch, "demo", "cornell", "--out", tmp_path, *options) == 2
    assert said in capsys.readouterr().err
