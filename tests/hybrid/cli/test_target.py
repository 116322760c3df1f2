"""Targets of `hybrid render`: settings are chosen from those that a sweep has measured."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from compose.base.errors import UserError
from hybrid.cli.render import TradeTarget, measuring_command
from hybrid.evaluation import sweep_catalogue as catalogue
from hybrid.evaluation.measured_settings import MeasuredSettings, MeasuredStore
from hybrid.preparation.scene_plan import as_planned
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


@pytest.fixture
def render(made, monkeypatch, tmp_path, capsys):
    """Renders with a target and returns the exit code, what was written, and the error or the output."""
    monkeypatch.setattr(catalogue, "_TRADE_OUTER", (20.0, 40.0))
    monkeypatch.setattr(catalogue, "_TRADE_SPP", (1,))

    def command(
        *options: object, size: tuple[int, int] = (48, 40), shown: bool = False
    ) -> tuple[int, dict, str]:
        out = tmp_path / "a.json"
        out.unlink(missing_ok=True)
        common = ["cornell", "--forest", made / "box.forest", "--size", *size, "-o", tmp_path / "a.png"]
        code = run(monkeypatch, "render", *common, "--json", out, *options)
        said = capsys.readouterr()
        return code, json.loads(out.read_text()) if out.exists() else {}, said.out if shown else said.err

    return command


def store(made, metric: str = "jod", **base: str) -> MeasuredStore:
    """Stores measurements as a sweep does: 10 ms for quality 7, 20 ms for 8, and 40 ms for 9."""
    settings = FrameSettings(**base)
    forest, scene = load_forest(made / "box.forest"), as_planned(load_scene("cornell"))
    found = MeasuredStore("trade", scene, forest, (48, 40), settings)
    rows = ((10.0, 7.0), (20.0, 8.0), (40.0, 9.0))
    measured = [
        MeasuredSettings(replace(settings, spp=spp, fov_a=10.0 * spp, fov_b=5.0 * spp, fovea="raw"), *row)
        for spp, row in enumerate(rows, 1)
    ]
    found.save(metric, measured)
    return found


def test_the_best_settings_that_a_sweep_has_measured_are_used(render, made, monkeypatch, tmp_path):
    code, _, error = render("--target-ms", 1e6)
    assert code == 2
    assert "--target-ms, --target-jod: these settings have not been measured here" in error
    assert f"run: hybrid sweep cornell --over trade --size 48 40 --forest {made / 'box.forest'}" in error
    out = tmp_path / "t.json"
    common = ["sweep", "cornell", "--forest", made / "box.forest", "--size", 48, 40, "--over", "trade"]
    effort = ["--repeats", 3, "--warm-up", 1, "--reference-spp", 4, "--json", out]
    assert run(monkeypatch, *common, *effort) == 0
    rows = json.loads(out.read_text())["rows"]
    assert len(rows) == 4
    code, used, _ = render("--target-ms", 1e6)
    assert code == 0
    metric = "whole jod" if "whole jod" in rows[0]["quality"] else "whole ssim"
    best = max(rows, key=lambda row: (row["quality"][metric], -row["ms"]["p50"]))
    assert (used["fovea"], used["spp"], used["fov_a"]) == (best["fovea"], best["spp"], best["fov_a"])
    code, _, error = render("--target-ms", 0.001)
    assert code == 2
    assert "the fastest settings take" in error


@pytest.mark.parametrize(
    ("target", "spp"),
    [
        (["--target-ms", 39], 2),
        (["--target-ms", 40], 3),
        (["--target-jod", 7.5], 2),
        (["--target-jod", 6, "--target-ms", 25], 1),
    ],
)
def test_fovea_radii_and_samples_are_chosen_and_all_else_is_as_asked(render, made, target, spp):
    store(made)
    code, used, _ = render(*target, "--gaze", 0.2, 0.3, "--fov-a", 50, "--spp", 9)
    assert code == 0
    assert (used["fovea"], used["spp"], used["fov_a"], used["fov_b"]) == ("raw", spp, 10 * spp, 5 * spp)
    assert (used["width"], used["height"], used["acuity_model"]) == (48, 40, "fovvideovdp")


def test_what_was_chosen_is_shown(render, made):
    store(made)
    assert render("--target-ms", 25, shown=True)[2].startswith(
        "--fovea raw --spp 2 --fov-a 20 --fov-b 10: "
        "measured to take 20 ms in views that nothing was fitted to\n"
    )


def test_a_target_that_nothing_meets_is_refused(render, made, tmp_path):
    store(made)
    code, _, error = render("--target-ms", 5)
    assert (code, error) == (2, "hybrid: target of 5 ms: the fastest settings take 10 ms\n")
    code, _, error = render("--target-jod", 9.5)
    assert (code, error) == (2, "hybrid: target of 9.5 JOD: the best settings reach 9.00\n")
    store(made, metric="ssim")
    code, _, error = render("--target-jod", 9)
    assert code == 2
    assert "quality was measured in SSIM" in error
    assert not (tmp_path / "a.png").exists()


def test_measurements_of_other_settings_are_not_used(render, made):
    store(made)
    for options in (["--acuity-model", "none"], ["--display", "hmd"]):
        code, _, error = render("--target-ms", 1e6, *options)
        assert code == 2
        assert "have not been measured here; run: hybrid sweep cornell --over trade" in error
        assert " ".join(options) in error
    assert render("--target-ms", 1e6, size=(40, 48))[0] == 2
    for options in (["--layers", 1, 1], ["--max-depth", 2]):
        code, _, error = render("--target-jod", 9, *options)
        assert code == 2
        assert f"nothing is measured with {options[0]}" in error
    # Measurements with one acuity model are kept beside those with another.
    store(made, acuity_model="none")
    for options in ([], ["--acuity-model", "none"]):
        assert render("--target-ms", 1e6, *options)[0] == 0


def test_damaged_measurements_are_named(render, made):
    file = store(made).file
    file.write_text('{"identity": ')
    code, _, error = render("--target-ms", 1e6)
    assert code == 2
    assert f"{file}: is damaged" in error


def test_without_a_forest_none_is_trained_before_the_refusal(monkeypatch, tmp_path, capsys):
    def forbidden(*_):
        raise AssertionError("trained")

    monkeypatch.setattr("hybrid.preparation.preparation.make_quick_forest", forbidden)
    assert run(monkeypatch, "render", "cornell", "-o", tmp_path / "a.png", "--target-jod", 9) == 2
    assert "run: hybrid sweep cornell --over trade --size" in capsys.readouterr().err


def test_without_a_target_nothing_is_looked_up():
    target, settings = TradeTarget(None, None, "measure"), FrameSettings()
    scene = SimpleNamespace(name="room", hash="ab" * 32)
    assert not target.is_set
    target.require_forest(scene, None)
    assert target.applied(scene, None, settings) is settings


def test_a_target_requires_a_forest_that_can_have_been_measured():
    scene = SimpleNamespace(name="room", hash="ab" * 32)
    for target in (
        TradeTarget(5.0, None, "measure"),
        TradeTarget(None, 9.0, "measure"),
        TradeTarget(0.0, None, "measure"),
    ):
        assert target.is_set
        target.require_forest(scene, Path("given.forest"))
        with pytest.raises(UserError, match=r"have not been measured here; run: measure$"):
            target.require_forest(scene, None)


def test_the_measuring_command_has_the_options_that_matter():
    usual = measuring_command("room", None, (48, 40), FrameSettings(spp=9), "desktop", "auto")
    assert usual == "hybrid sweep room --over trade --size 48 40"
    other = FrameSettings(acuity_model="fov-gs")
    command = measuring_command("my scene.xml", Path("a b.forest"), (48, 40), other, "hmd", "llvm")
    assert command == (
        "hybrid sweep 'my scene.xml' --over trade --size 48 40 --forest 'a b.forest' "
        "--acuity-model fov-gs --display hmd --backend llvm"
    )
