"""Settings for a time or a quality, from what was measured."""

from __future__ import annotations

import json

import pytest

from compose.errors import UserError
from hybrid.sweeps import catalogue
from hybrid.trade import Choice, chosen
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def choice(milliseconds: float, quality: float) -> Choice:
    return Choice("fused", 2, 20.0, 15.0, milliseconds, quality)


CHOICES = [choice(50, 8.0), choice(100, 9.0), choice(120, 8.9), choice(400, 9.6)]


def test_the_best_in_a_time_and_the_fastest_of_a_quality():
    assert chosen(CHOICES, 130, None).milliseconds == 100
    assert chosen(CHOICES, None, 8.5).milliseconds == 100
    assert chosen(CHOICES, 500, 9.5).milliseconds == 400
    with pytest.raises(UserError, match="--target-ms 40: the fastest settings take 50 ms"):
        chosen(CHOICES, 40, None)
    with pytest.raises(UserError, match=r"--target-jod 9.5: the best settings in 130 ms reach 9.00"):
        chosen(CHOICES, 130, 9.5)


def test_render_takes_what_a_sweep_has_measured(made, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(catalogue, "_TRADE_OUTER", (20.0, 40.0))
    monkeypatch.setattr(catalogue, "_TRADE_SPP", (1,))
    common = ["cornell", "--forest", made / "box.forest", "--size", 48, 40]
    picture = ["-o", tmp_path / "a.png", "--json", tmp_path / "a.json"]
    assert run(monkeypatch, "render", *common, *picture, "--target-ms", 1e6) == 2
    assert "run: hybrid sweep cornell --over trade --size 48 40" in capsys.readouterr().err
    options = ["--repeats", 3, "--warm-up", 1, "--reference-spp", 4, "--json", tmp_path / "t.json"]
    assert run(monkeypatch, "sweep", *common, "--over", "trade", *options) == 0
    rows = json.loads((tmp_path / "t.json").read_text())["rows"]
    assert len(rows) == 4
    assert run(monkeypatch, "render", *common, *picture, "--target-ms", 1e6) == 0
    metric = "whole jod" if "whole jod" in rows[0]["quality"] else "whole ssim"
    best = max(rows, key=lambda row: (row["quality"][metric], -row["ms"]["p50"]))
    taken = json.loads((tmp_path / "a.json").read_text())
    assert (taken["fovea"], taken["spp"], taken["fov_a"]) == (best["fovea"], best["spp"], best["fov_a"])
    assert run(monkeypatch, "render", *common, *picture, "--target-ms", 0.001) == 2
    assert "the fastest settings take" in capsys.readouterr().err
