"""Evaluates hybrid frames of a scene and writes the report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from compose.base.files import json_text, write_whole
from hybrid.base.identity import require_scene
from hybrid.base.progress import Progress, no_progress
from hybrid.evaluation.evaluation import Evaluation
from hybrid.evaluation.evaluation_page import write_report
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.render.forest_attachments import scene_as_trained
from pathtrace.scene.scene import Scene
from splat.io.forest_file import load_forest
from splat.model.forest import Forest


def evaluate(
    scene: Scene,
    forest: Forest,
    folder: Path | str,
    settings: EvaluationSettings | None = None,
    *,
    baseline_forest: Path | str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Compares hybrid frames with baselines at equal rays and at equal time; resumes if interrupted.

    Writes index.html (a page that requires no server), evaluation.json and all images. Metrics run in
    processes of their own: call it from a program under `if __name__ == "__main__":`.

    Args:
        scene, forest: what is rendered; a scene without a plan has the paths planned for the forest.
        folder: for the report; the evaluation resumes from what it finds there.
        settings: what to measure; the defaults of EvaluationSettings if None.
        baseline_forest: forest file of Gaussians without trees (trained with one layer) to compare with.
        progress: called with work done, work in total (of the whole evaluation, in expected milliseconds),
            and the current activity.

    Returns:
        The content of evaluation.json: scene, settings, display, references, methods, quality (rows of view,
        method, budget, region, metric, value), time (rows of method, budget, ms, passes), machine.

    Raises:
        UserError: the settings cannot be measured, a forest belongs to another scene, or the folder holds
            another evaluation.
    """
    settings = settings or EvaluationSettings()
    settings.require_measurable()
    scene, folder, flat = scene_as_trained(scene, forest), Path(folder), None
    if baseline_forest is not None:
        flat = load_forest(Path(baseline_forest))
        require_scene(flat, scene.name, scene.hash, baseline_forest)
    evaluation = Evaluation(scene, forest, settings, folder, flat)
    found = evaluation.run(lambda activity, done, total: progress(int(done), int(total), activity))
    text = json_text(found)
    write_whole(folder / "evaluation.json", lambda part: part.write_text(text))
    write_report(folder)
    return found
