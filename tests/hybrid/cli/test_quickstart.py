"""`hybrid quickstart`; the workflow itself is tested in its own room."""

from __future__ import annotations

import json

import pytest

from hybrid.cli import options
from hybrid.cli.prepare import quickstart as command
from hybrid.evaluation import quickstart as module
from hybrid.render.frame_settings import DEFAULTS, FrameSettings
from pathtrace.scene.scene import load_scene
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")
RESULT = {
    "hybrid": {"psnr": 35.004},
    "splats_alone": {"psnr": 30.456},
    "ratio": 5.043,
    "seconds": {"total": 200.4},
}


@pytest.fixture
def given(monkeypatch):
    """What the workflow is given; scenes are not looked at."""
    notes = []
    monkeypatch.setattr(options, "planned_scene", lambda name, *_: load_scene(name))

    def quickstart(scene, folder, settings, seed, bars):
        notes.append((scene.name, folder, settings, seed))
        return RESULT

    monkeypatch.setattr(module, "quickstart", quickstart)
    return notes


def test_the_numbers_are_written_and_shown(given, monkeypatch, tmp_path, capsys):
    out, extra = tmp_path / "out", tmp_path / "extra.json"
    options = ["--fov-a", 30, "--fov-b", 10, "--seed", 4, "--json", extra]
    assert run(monkeypatch, command.__name__, "cornell", "--out", out, *options) == 0
    assert given == [("cornell", out, FrameSettings(fov_a=30, fov_b=10), 4)]
    for file in (out / "result.json", extra):
        assert json.loads(file.read_text()) == RESULT
    assert capsys.readouterr().out.splitlines() == [
        "hybrid 35.00 dB, splats 30.46 dB, 5.04 x faster than full path tracing, 200 s in total",
        f"Open {out / 'index.html'}",
    ]


def test_without_arguments_the_room_goes_into_the_folder_out(given, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "quickstart") == 0
    ((name, folder, settings, seed),) = given
    assert (name, str(folder), settings, seed) == ("room", "out", DEFAULTS, 0)
    assert (tmp_path / "out" / "result.json").is_file()
