"""`hybrid bench periphery`."""

from __future__ import annotations

import json

import pytest

from compose.eye.acuity import ACUITY_MODELS
from hybrid.cli.bench import periphery as command
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_there_is_a_row_per_acuity_model_and_gaze(made, display, monkeypatch, tmp_path, capsys):
    out = tmp_path / "p.json"
    common = ["bench", command.__name__, "cornell", "--forest", made / "box.forest", "--display", display]
    assert run(monkeypatch, *common, "--repeats", 3, "--warm-up", 1, "--json", out) == 0
    rows = json.loads(out.read_text())
    assert [(row["acuity_model"], row["gaze"]) for row in rows[: len(ACUITY_MODELS)]] == [
        (acuity_model, [0.5, 0.5]) for acuity_model in ACUITY_MODELS
    ]
    assert len(rows) == 14
    for row in rows:
        names = "acuity_model gaze width height periphery_ms full_ms ratio nodes_drawn jod ssim scene machine"
        assert set(names.split()) <= set(row)
        assert (row["width"], row["height"], row["scene"]) == (192, 128, "cornell")
        for name in ("periphery_ms", "full_ms", "moving_ms", "moving_full_ms"):
            assert 0 < row[name]["p50"] <= row[name]["p95"]
        if row["acuity_model"] == "none":
            assert row["ratio"] == 1
            assert row["ssim"] == pytest.approx(1)
    shown = capsys.readouterr().out.splitlines()
    assert [line.split()[2] for line in shown[2:16]] == [row["acuity_model"] for row in rows]
