"""Settings for a time or a quality, from what was measured."""

from __future__ import annotations

import json

import pytest
from hybrid.plan.trade import Choice, Trade, chosen

from compose.base.errors import UserError
from hybrid.sweeps import catalogue
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def choice(milliseconds: float, quality: float) -> Choice:
    return Choice("fused", 2, 20.0, 15.0, milliseconds, quality)


TRADE = Trade("jod", [choice(50, 8.0), choice(100, 9.0), choice(120, 8.9), choice(400, 9.6)])


def test_the_best_in_a_time_and_the_fastest_of_a_quality():
    assert chosen(TRADE, 130, None).milliseconds == 100
    assert chosen(TRADE, None, 8.5).milliseconds == 100
    assert chosen(TRADE, 500, 9.5).milliseconds == 400
    with pytest.raises(UserError, match="--target-ms 40: the fastest settings take 50 ms"):
        chosen(TRADE, 40, None)
    with pytest.raises(UserError, match=r"--target-jod 9.5: the best settings in 130 ms reach 9.00"):
        chosen(TRADE, 130, 9.5)


def test_a_quality_in_jod_is_not_compared_with_another_metric():
    similarity = Trade("ssim", [choice(50, 0.9)])
    assert chosen(similarity, 60, None).quality == 0.9
    with pytest.raises(UserError, match=r"--target-jod 0.5: .* in SSIM; JOD needs FovVideoVDP .*pip install"):
        chosen(similarity, None, 0.5)


@pytest.fixture
def render(made, monkeypatch, tmp_path, capsys):
    """Renders with a target and returns the exit code, what was written, and the error."""
    monkeypatch.setattr(catalogue, "_TRADE_OUTER", (20.0, 40.0))
    monkeypatch.setattr(catalogue, "_TRADE_SPP", (1,))

    def command(*options: object, size: tuple[int, int] = (48, 40)) -> tuple[int, dict, str]:
        out = tmp_path / "a.json"
        out.unlink(missing_ok=True)
        common = ["cornell", "--forest", made / "box.forest", "--size", *size, "-o", tmp_path / "a.png"]
        code = run(monkeypatch, "render", *common, "--json", out, *options)
        return code, json.loads(out.read_text()) if out.exists() else {}, capsys.readouterr().err

    return command


def measure(monkeypatch, made, tmp_path, *options: object) -> list[dict]:
    out = tmp_path / "t.json"
    common = ["sweep", "cornell", "--forest", made / "box.forest", "--size", 48, 40, "--over", "trade"]
    effort = ["--repeats", 3, "--warm-up", 1, "--reference-spp", 4, "--json", out]
    assert run(monkeypatch, *common, *effort, *options) == 0
    return json.loads(out.read_text())["rows"]


def test_render_takes_what_a_sweep_has_measured(render, made, monkeypatch, tmp_path):
    code, _, error = render("--target-ms", 1e6)
    assert code == 2
    assert f"run: hybrid sweep cornell --over trade --size 48 40 --forest {made / 'box.forest'}" in error
    rows = measure(monkeypatch, made, tmp_path)
    assert len(rows) == 4
    code, taken, _ = render("--target-ms", 1e6)
    assert code == 0
    metric = "whole jod" if "whole jod" in rows[0]["quality"] else "whole ssim"
    best = max(rows, key=lambda row: (row["quality"][metric], -row["ms"]["p50"]))
    assert (taken["fovea"], taken["spp"], taken["fov_a"]) == (best["fovea"], best["spp"], best["fov_a"])
    code, _, error = render("--target-ms", 0.001)
    assert code == 2
    assert "the fastest settings take" in error


def test_figures_of_other_settings_are_not_taken(render, made, monkeypatch, tmp_path):
    measure(monkeypatch, made, tmp_path)
    for options in (["--acuity-model", "none"], ["--display", "hmd"]):
        code, _, error = render("--target-ms", 1e6, *options)
        assert code == 2
        assert "were not measured here yet; run: hybrid sweep cornell --over trade" in error
        assert " ".join(options) in error
    assert render("--target-ms", 1e6, size=(40, 48))[0] == 2
    for options in (["--layers", 1, 1], ["--max-depth", 2]):
        code, _, error = render("--target-ms", 1e6, *options)
        assert code == 2
        assert f"nothing is measured with {options[0]}" in error
    # What was measured for one is kept beside what was measured for another.
    measure(monkeypatch, made, tmp_path, "--acuity-model", "none")
    for options in ([], ["--acuity-model", "none"]):
        assert render("--target-ms", 1e6, *options)[0] == 0


def test_without_a_forest_nothing_is_trained_before_it_is_refused(monkeypatch, tmp_path, capsys):
    def forbidden(*_):
        raise AssertionError("trained")

    monkeypatch.setattr("hybrid.training.quick.make_quick_forest", forbidden)
    assert run(monkeypatch, "render", "cornell", "-o", tmp_path / "a.png", "--target-jod", 9) == 2
    assert "run: hybrid sweep cornell --over trade --size" in capsys.readouterr().err


def test_a_damaged_trade_is_named(render, made, monkeypatch, tmp_path):
    measure(monkeypatch, made, tmp_path)
    (kept,) = (tmp_path / "home").glob("*/trade-48x40-*.json")
    kept.write_text('{"identity": ')
    code, _, error = render("--target-ms", 1e6)
    assert code == 2
    assert f"{kept}: is damaged" in error
