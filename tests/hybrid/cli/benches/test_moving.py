"""`hybrid bench moving`; what it measures is tested in its own room."""

from __future__ import annotations

import json

import pytest

from hybrid.cli.bench import moving as command
from hybrid.evaluation import moving_bench as module
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest, save_forest
from tests.hybrid.command import run
from tests.hybrid.forests import rough_forest

pytestmark = pytest.mark.usefixtures("backend", "own_home")
ROWS = [
    {
        "method": method,
        "region": region,
        "psnr": psnr,
        "ms": {"p50": 20.0, "p95": 30.0},
        "ratio": ratio,
        **more,
    }
    for method, ratio, region, psnr, more in [
        ("hybrid", 1.0, "whole", 30.126, {"jod": 9.5}),
        ("hybrid", 1.0, "moving", 25.5, {"registration_px": 0.126}),
        ("splats alone", 0.5, "whole", 28.0, {"jod": None}),
    ]
]


def test_each_method_has_a_line(monkeypatch, tmp_path, capsys):
    given = []

    def bench_moving(scene, forest, settings, reference_spp, bar, others):
        given.append((scene.name, settings.camera.width, settings.spp, reference_spp, list(others)))
        return ROWS

    monkeypatch.setattr(module, "bench_moving", bench_moving)
    forest, other, out = tmp_path / "f", tmp_path / "other.forest", tmp_path / "rows.json"
    save_forest(forest, rough_forest(load_scene("cloth")))
    save_forest(other, load_forest(forest))
    common = ["bench", command.__name__, "cloth", "--forest", forest, "--size", 48, 32, "--spp", 2]
    assert run(monkeypatch, *common, "--reference-spp", 8, "--against", other, "--json", out) == 0
    assert given == [("cloth", 48, 2, 8, ["other"])]
    written = json.loads(out.read_text())
    assert {name: written[name] for name in ("scene", "size", "spp", "rows")} == {
        "scene": "cloth",
        "size": [48, 32],
        "spp": 2,
        "rows": ROWS,
    }
    shown = [line.split() for line in capsys.readouterr().out.splitlines()[-4:]]
    assert shown == [
        ["method", "whole", "moving", "ms", "p95", "ratio"],
        ["hybrid", "30.13", "dB", "25.50", "dB", "20.0", "30.0", "1.00"],
        ["splats", "alone", "28.00", "dB", "20.0", "30.0", "0.50"],
        ["hybrid:", "9.50", "JOD", "(whole),", "what", "moves", "is", "off", "by", "0.13", "px"],
    ]
