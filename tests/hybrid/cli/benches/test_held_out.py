"""`hybrid bench held-out`."""

from __future__ import annotations

import json

import pytest

from hybrid.cli.benches import held_out as command
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_only_the_periphery_is_replaced(made, monkeypatch, tmp_path, capsys):
    out = tmp_path / "h.json"
    name = command.held_out.__name__.replace("_", "-")
    common = ["bench", name, made / "frames", made / "box.forest", "--json", out]
    assert run(monkeypatch, *common, "--fov-b", 20) == 0
    rows = json.loads(out.read_text())
    assert [row["views"] for row in rows] == [3] * 5
    shown = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in shown[1:6]] == [row["acuity_model"] for row in rows]
    assert run(monkeypatch, *common, "--fov-b", 100) == 0
    whole = json.loads(out.read_text())
    for part, same in zip(rows, whole, strict=True):
        assert part["psnr"] < 60 < same["psnr"]
        assert same["ssim"] == pytest.approx(1)
