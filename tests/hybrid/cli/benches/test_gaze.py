"""`hybrid bench gaze`; what it measures is tested in its own room."""

from __future__ import annotations

import json

import pytest

from compose.eye.gaze import Gaze, GazeTrace
from hybrid.cli.bench import gaze as command
from hybrid.evaluation import gaze_bench as module
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import save_forest
from tests.hybrid.command import run
from tests.hybrid.forests import rough_forest

pytestmark = pytest.mark.usefixtures("backend", "own_home")
COMMON = {
    **dict.fromkeys(("low", "high", "foveal_low", "foveal_high")),
    "foveal_jod": 6.0,
    "width": 48,
    "height": 32,
    "clips": 1,
    "frames": 3,
}
ROWS = [
    {
        "method": "hybrid",
        "latency_ms": 50.0,
        "gaze_error_deg": 1.5,
        "jod": 8.126,
        "flicker": 0.1234,
        "ms": 20.06,
        **COMMON,
    },
    {
        "method": "TAA",
        "latency_ms": None,
        "gaze_error_deg": None,
        "jod": 7.0,
        "flicker": None,
        "ms": 3.0,
        **COMMON,
    },
]


def test_each_row_has_a_line_and_names_what_was_shown(monkeypatch, tmp_path, capsys):
    given = []

    def bench_gaze(scene, forest, settings, clips, trace, tracked, write, bar):
        display = settings.display
        given.append((scene.name, display.width, display.fov, clips.frames, clips.walks, trace, tracked))
        write(ROWS)
        return ROWS

    monkeypatch.setattr(module, "bench_gaze", bench_gaze)
    forest, out, trace = tmp_path / "f", tmp_path / "rows.json", tmp_path / "somebody.csv"
    save_forest(forest, rough_forest(load_scene("cloth")))
    looked = GazeTrace((0.0, 2.0), (Gaze(0.25, 0.5), Gaze(0.75, 0.5)))
    looked.save(trace)
    common = ["bench", command.__name__, "cloth", "--forest", forest, "--size", 48, 32, "--walk"]
    more = ["--latency", 50, "--gaze-error", 1.5, "--gaze-trace", trace, "--seconds", 0.25, "--fps", 12]
    assert run(monkeypatch, *common, *more, "--json", out) == 0
    assert given == [("cloth", 48, 55.0, 3, True, looked, ([50.0], [1.5]))]
    for written, row in zip(json.loads(out.read_text()), ROWS, strict=True):
        assert {name: written[name] for name in row} == row
        assert (written["display"], written["gaze"], written["scene"]) == ("desktop", "somebody", "cloth")
    shown = [line.split() for line in capsys.readouterr().out.splitlines()[-2:]]
    assert shown == [
        ["hybrid", "50", "1.5", "8.13", "-", "-", "6.00", "-", "-", "0.12", "20.1"],
        ["TAA", "-", "-", "7.00", "-", "-", "6.00", "-", "-", "-", "3.0"],
    ]


@pytest.mark.parametrize("option", ["--latency", "--gaze-error"])
@pytest.mark.parametrize("value", ["nan", "-1", "1e9"])
def test_what_no_tracker_has_is_refused(monkeypatch, capsys, option, value):
    assert run(monkeypatch, "bench", "gaze", "room", option, value) == 2
    assert f"Invalid value for '{option}'" in capsys.readouterr().err
