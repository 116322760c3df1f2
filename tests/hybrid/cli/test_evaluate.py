"""`hybrid evaluate`: its options and what it prints; evaluations themselves are tested in their own room."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from hybrid.api import workflow as api
from hybrid.base.identity import code, machine
from hybrid.base.parts import Part, StoredPart, begin
from hybrid.cli import evaluate as module
from hybrid.evaluation import evaluation, verdicts
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.measure import frame_quality as installed
from hybrid.preparation import preparation as quick
from hybrid.render.frame_settings import FrameSettings
from splat.io.forest_file import load_forest, save_forest
from tests.hybrid.command import run
from tests.hybrid.evaluation import content

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def quality(key: tuple[str, str], region: str, metric: str, *values: float) -> list[dict]:
    method, budget = key
    common = {"method": method, "budget": budget, "region": region, "metric": metric}
    return [{**common, "view": view, "seed": 0, "value": value} for view, value in enumerate(values)]


FOUND = {
    "views": [{"view": view, "kind": "near", "time": 0.0} for view in range(2)],
    "methods": [{"method": "hybrid", "budget": "fixed"}, {"method": "rmfr", "budget": "equal time"}],
    "time": [{"method": "hybrid", "budget": "fixed", "ms": {"p50": 101.6}}],
    "quality": [
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
    monkeypatch.setattr(verdicts, "sentences", lambda found: ["Hybrid frames are ahead."])
    monkeypatch.setattr(installed, "missing", lambda: ["FLIP is not installed."])
    return notes


def test_every_option_reaches_the_settings(given, made, monkeypatch, tmp_path):
    flat = load_forest(made / "box.forest")
    save_forest(tmp_path / "flat", flat)
    options = ["--size", 40, 30, "--views", 2, "--gaze", 0.2, 0.3, "--fov-a", 30, "--fov-b", 10, "--spp", 3]
    options += [
        "--apart",
        1,
        "--seeds",
        7,
        "--reference-spp",
        5,
        "--raw-references",
        "--repeats",
        4,
        "--quick",
    ]
    options += ["--display", "hmd", "--seed", 6]
    options += ["--baseline-forest", tmp_path / "flat", "--json", tmp_path / "e.json"]
    common = ["evaluate", "cornell", "--forest", made / "box.forest", "--report", tmp_path / "r"]
    assert run(monkeypatch, *common, *options) == 0
    frame = FrameSettings((0.2, 0.3), 30, 10, 3, display="hmd")
    expected = EvaluationSettings(frame, 40, 30, 2, 1, 7, 5, False, 4, True, 6)
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
    hybrid, rmfr = (line.split() for line in lines[4:])
    assert hybrid == ["hybrid", "fixed", "102", "30.5"]
    assert rmfr == ["rmfr", "equal", "time", "-", "25.75"]


def test_a_part_says_what_comes_next_and_makes_no_page(given, made, monkeypatch, tmp_path, capsys):
    parts = []

    class Evaluation:
        part = None

        def run(self, progress):
            progress("view 2: times", 0.5, 1)
            return FOUND

    def evaluation_of(scene, forest, settings, folder, baseline_forest, part):
        parts.append((scene.name, settings, folder, baseline_forest, part))
        found = Evaluation()
        found.part = StoredPart(folder / "part-2-of-3", "evaluate", part, {}, {})
        return found

    monkeypatch.setattr(evaluation, "evaluation_of", evaluation_of)
    options = ["--forest", made / "box.forest", "--report", tmp_path / "r", "--json", tmp_path / "e.json"]
    assert run(monkeypatch, "evaluate", "cornell", *options, "--part", "2/3") == 0
    assert parts == [("cornell", EvaluationSettings(), tmp_path / "r", None, Part(2, 3))]
    assert capsys.readouterr().out.splitlines() == [
        f"part 2 of 3 in {tmp_path / 'r' / 'part-2-of-3'}; when all are there: hybrid merge {tmp_path / 'r'}"
    ]
    assert json.loads((tmp_path / "e.json").read_text()) == json.loads(json.dumps(FOUND))
    assert not given
    assert not (tmp_path / "r" / "index.html").exists()


def test_merging_parts_makes_the_page(monkeypatch, tmp_path, capsys):
    identity = {"code": code(), "machine": machine()}
    begin(tmp_path, "evaluate", Part(1, 1), identity).finish()
    found = content.evaluation()
    monkeypatch.setattr(evaluation, "merged_evaluation", lambda folder: found if folder == tmp_path else None)
    assert run(monkeypatch, "merge", tmp_path, "--json", tmp_path / "m.json") == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("corner, 32x16")] == verdicts.sentences(found)[:4]
    assert str(tmp_path / "index.html") in lines
    assert "Evaluation of corner" in (tmp_path / "index.html").read_text()
    for name in ("evaluation.json", "m.json"):
        assert json.loads((tmp_path / name).read_text()) == json.loads(json.dumps(found))


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
