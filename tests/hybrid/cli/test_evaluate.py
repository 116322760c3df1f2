"""`hybrid evaluate`: its options and what it prints; evaluations themselves are tested in their own room."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from hybrid.api import workflow as api
from hybrid.cli import evaluate as module
from hybrid.evaluation import results as verdicts
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.evaluation.results import HALVES_KEY
from hybrid.measure import frame_quality as installed
from hybrid.preparation import preparation as quick
from hybrid.render.frame_settings import FrameSettings
from splat.io.forest_file import load_forest, save_forest
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def quality(key: tuple[str, str], region: str, metric: str, *values: float) -> list[dict]:
    method, budget = key
    common = {"method": method, "budget": budget, "region": region, "metric": metric}
    return [{**common, "view": view, "value": value} for view, value in enumerate(values)]


FOUND = {
    "methods": [{"method": "hybrid", "budget": "fixed"}, {"method": "rmfr", "budget": "equal time"}],
    "time": [{"method": "hybrid", "budget": "fixed", "ms": {"p50": 101.6}}],
    "quality": [
        *quality(HALVES_KEY, "foveal", "psnr", 40.0, 42.0),
        *quality(("hybrid", "fixed"), "foveal", "psnr", 30.0, 31.0),
        *quality(("rmfr", "equal time"), "foveal", "psnr", 25.0, 26.5),
        # Not measured for all methods, and thus not printed.
        *quality(("hybrid", "fixed"), "whole", "ssim", 0.9),
    ],
}


@pytest.fixture
def given(monkeypatch):
    """What the evaluation is given."""
    notes = []

    def evaluate(scene, forest, folder, settings, *, baseline_forest, progress):
        progress(1, 4, "references")
        notes.append((scene.name, len(forest.counts), folder, settings, baseline_forest))
        return FOUND

    monkeypatch.setattr(api, "evaluate", evaluate)
    monkeypatch.setattr(verdicts, "verdicts", lambda found: ["Hybrid frames are ahead."])
    monkeypatch.setattr(installed, "missing", lambda: ["FLIP is not installed."])
    return notes


def test_every_option_reaches_the_settings(given, made, monkeypatch, tmp_path):
    flat = load_forest(made / "box.forest")
    save_forest(tmp_path / "flat", flat)
    options = ["--size", 40, 30, "--views", 2, "--gaze", 0.2, 0.3, "--fov-a", 30, "--fov-b", 10, "--spp", 3]
    options += ["--reference-spp", 5, "--repeats", 4, "--display", "hmd", "--seed", 6]
    options += ["--baseline-forest", tmp_path / "flat", "--json", tmp_path / "e.json"]
    common = ["evaluate", "cornell", "--forest", made / "box.forest", "--report", tmp_path / "r"]
    assert run(monkeypatch, *common, *options) == 0
    frame = FrameSettings((0.2, 0.3), 30, 10, 3, display="hmd")
    expected = EvaluationSettings(frame, 40, 30, 2, 5, 4, 6)
    assert given == [("cornell", 2, tmp_path / "r", expected, tmp_path / "flat")]
    assert json.loads((tmp_path / "e.json").read_text()) == json.loads(json.dumps(FOUND))


def test_the_defaults_are_those_of_the_settings(given, made, monkeypatch, tmp_path):
    common = [module.evaluate.__name__, "cornell", "--forest", made / "box.forest"]
    assert run(monkeypatch, *common, "--report", tmp_path / "r") == 0
    assert given == [("cornell", 2, tmp_path / "r", EvaluationSettings(), None)]


def test_sentences_and_means_are_printed(given, made, monkeypatch, tmp_path, capsys):
    common = ["evaluate", "cornell", "--forest", made / "box.forest", "--report", tmp_path / "r"]
    assert run(monkeypatch, *common) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == [
        "FLIP is not installed.",
        "Hybrid frames are ahead.",
        str(tmp_path / "r" / "index.html"),
    ]
    assert lines[3].split() == ["method", "budget", "ms", "fov", "psnr"]
    halves, hybrid, rmfr = (line.split() for line in lines[4:])
    assert halves[-2:] == ["-", "41"]
    assert hybrid == ["hybrid", "fixed", "102", "30.5"]
    assert rmfr == ["rmfr", "equal", "time", "-", "25.75"]


def test_a_forest_is_trained_before_the_bar_of_the_evaluation_appears(given, made, monkeypatch, tmp_path):
    order = []
    forest = load_forest(made / "box.forest")
    bar = module.progress_bar

    def noted_bar(title):
        order.append(title)
        return bar(title)

    monkeypatch.setattr(module, "progress_bar", noted_bar)

    def trains(scene, given, bars):
        order.append("train")
        return scene, forest

    monkeypatch.setattr(quick, "with_forest", trains)
    assert run(monkeypatch, "evaluate", "cornell", "--report", tmp_path / "r") == 0
    assert order == ["train", "evaluate"]


def test_a_baseline_of_another_scene_is_refused_before_a_forest_is_trained(
    given, made, monkeypatch, tmp_path, capsys
):
    flat = replace(load_forest(made / "box.forest"), scene_name="room", scene_hash="cd" * 32)
    save_forest(tmp_path / "flat", flat)
    monkeypatch.setattr(quick, "with_forest", None)
    options = ["--report", tmp_path / "r", "--baseline-forest", tmp_path / "flat"]
    assert run(monkeypatch, "evaluate", "cornell", *options) == 2
    assert capsys.readouterr().err.startswith(f"hybrid: {tmp_path / 'flat'} belongs to scene room")
    assert not given
