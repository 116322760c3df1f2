"""Evaluating in Python: what is measured, what is written, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest

from compose.base.errors import UserError
from hybrid.api.workflow import evaluate
from hybrid.evaluation import evaluation, evaluation_page
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from splat.io.forest_file import save_forest
from tests.hybrid.forests import white_dot

SCENE = SimpleNamespace(name="room", hash="ab" * 32, plan={"degree": 0})
FOREST = white_dot((0, 0, 1))
FOUND = {"scene": "room", "time": [{"ms": 1.5}]}


@pytest.fixture
def given(monkeypatch):
    """What evaluation and report are given, in order; the evaluation itself is not run."""
    notes = []

    class Evaluation:
        def __init__(self, *arguments):
            notes.append(arguments)

        def run(self, progress):
            progress("view 2: quality", 1.5, 3.0)
            return FOUND

    monkeypatch.setattr(evaluation, "Evaluation", Evaluation)
    monkeypatch.setattr(
        evaluation_page, "write_report", lambda folder: notes.append((folder / "evaluation.json").read_text())
    )
    return notes


def test_the_figures_are_written_before_the_report(given, tmp_path):
    found = evaluate(SCENE, FOREST, str(tmp_path / "r"))
    assert found == FOUND
    arguments, text = given
    # Neither a baseline forest, nor a part.
    assert arguments == (SCENE, FOREST, EvaluationSettings(), tmp_path / "r", None, None)
    assert json.loads(text) == FOUND
    assert text.endswith("\n")


def test_settings_and_progress_are_those_given(given, tmp_path):
    steps = []
    settings = EvaluationSettings(views=2)
    evaluate(SCENE, FOREST, tmp_path, settings, progress=lambda *step: steps.append(step))
    assert given[0][2] == settings
    # In thousandths of a view.
    assert steps == [(1500, 3000, "view 2: quality")]


def test_a_baseline_forest_is_loaded_from_its_file(given, tmp_path):
    flat = replace(white_dot((0, 0, 2)), scene_name="room", scene_hash="ab" * 32)
    save_forest(tmp_path / "flat.forest", flat)
    evaluate(SCENE, FOREST, tmp_path / "r", baseline_forest=str(tmp_path / "flat.forest"))
    assert given[0][4].digest() == flat.digest()


def test_a_baseline_forest_of_another_scene_is_refused(given, tmp_path):
    save_forest(tmp_path / "flat.forest", replace(FOREST, scene_name="cornell", scene_hash="cd" * 32))
    message = f"^{tmp_path / 'flat.forest'} belongs to scene cornell"
    with pytest.raises(UserError, match=message):
        evaluate(SCENE, FOREST, tmp_path / "r", baseline_forest=tmp_path / "flat.forest")
    assert not given
    assert not (tmp_path / "r").exists()
