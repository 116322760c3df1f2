"""Quality of all methods in all views: rows, images, and what the journal saves."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.image.colour import bytes_from_radiance
from hybrid.base.identity import Journal
from hybrid.evaluation import entries as quality
from hybrid.evaluation.entries import Entry, evaluated_views, quality_rows
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.evaluation.results import HALVES
from hybrid.measure.reference import Reference
from hybrid.render.frame_settings import FrameSettings
from tests import small
from tests.hybrid.evaluation.fakes import VIEW, Recorder

SIZE = 32
SETTINGS = EvaluationSettings(FrameSettings((0.5, 0.5), 30, 15), SIZE, SIZE, views=2, seed=5)


def references() -> list[Reference]:
    found = []
    for seed in range(2):
        halves = tuple(
            small.rng(2 * seed + half).uniform(0.2, 0.8, (SIZE, SIZE, 3)).astype(np.float32)
            for half in range(2)
        )
        found.append(Reference(0.5 * (halves[0] + halves[1]), halves, np.zeros((SIZE, SIZE), np.float32)))
    return found


@pytest.fixture
def evaluated(tmp_path, monkeypatch):
    """Evaluates entries in two views, scoring without processes: by name and mean brightness."""
    scored = []

    def in_turns(tasks):
        for name, task in tasks:
            scored.append((name, task))
            yield name, [{"region": "whole", "metric": "psnr", "value": float(task.image.mean())}]

    monkeypatch.setattr(quality, "scored_in_parallel", in_turns)
    shown = [VIEW.resized(SIZE, SIZE)] * 2
    views = evaluated_views(shown, references(), SETTINGS, tmp_path)

    def run(entries, journal=None, progress=lambda done, total: None):
        scored.clear()
        journal = journal or Journal(tmp_path / "journal.json", {})
        return quality_rows(entries, views, journal, progress), list(scored)

    return run


def test_each_view_has_rows_of_its_reference_and_of_all_entries(evaluated, tmp_path):
    rows, _ = evaluated([Entry("full", "equal-time", Recorder(1))])
    assert [(row["view"], row["method"], row["budget"]) for row in rows] == [
        (0, HALVES, "fixed"),
        (0, "full", "equal-time"),
        (1, HALVES, "fixed"),
        (1, "full", "equal-time"),
    ]
    assert rows[1] == {
        "view": 0,
        "method": "full",
        "budget": "equal-time",
        "region": "whole",
        "metric": "psnr",
        "value": 0.5,
    }
    assert {file.name for file in tmp_path.glob("*.png")} == {
        f"{view}-{name}.png" for view in range(2) for name in ("reference", "full-equal-time")
    }


def test_a_reference_is_compared_half_against_half_and_a_frame_with_all_of_it(evaluated):
    _, scored = evaluated([Entry("full", "equal-time", Recorder(1))])
    of_reference, of_frame = (task for _, task in scored[:2])
    truth = references()[0]
    np.testing.assert_array_equal(of_reference.image, truth.halves[0])
    np.testing.assert_array_equal(of_reference.reference, truth.halves[1])
    assert of_reference.halves == ()
    assert of_reference.flip_file is None
    np.testing.assert_array_equal(of_frame.reference, truth.radiance)
    np.testing.assert_array_equal(of_frame.halves, truth.halves)
    assert of_frame.flip_file.name == "0-full-equal-time-flip.png"
    assert of_frame.method == "full"
    assert set(of_frame.regions) == {"whole", "foveal", "seam", "peripheral", "salient"}
    assert of_frame.viewer.gaze == SETTINGS.frame.gaze
    assert of_frame.viewer.display == SETTINGS.frame.display


def test_each_view_has_a_seed_of_its_own_and_the_gaze_of_the_settings(evaluated):
    method = Recorder(1)
    evaluated([Entry("full", "fixed", method)])
    assert method.seeds == [5, 6]
    assert method.gazes == [SETTINGS.frame.gaze] * 2


def test_written_images_show_what_was_scored(evaluated, tmp_path):
    from PIL import Image as PillowImage

    evaluated([])
    shown = np.asarray(PillowImage.open(tmp_path / "1-reference.png"))
    np.testing.assert_array_equal(shown, bytes_from_radiance(references()[1].radiance))


def test_what_the_journal_holds_is_not_rendered_again(evaluated, tmp_path):
    first, _ = evaluated([Entry("full", "fixed", Recorder(1))])
    steps = []
    method, other = Recorder(1), Recorder(2)
    entries = [Entry("full", "fixed", method), Entry("full", "equal-time", other)]
    rows, _ = evaluated(entries, progress=lambda *step: steps.append(step))
    assert not method.seeds
    assert other.seeds == [5, 6]
    assert [row for row in rows if row["budget"] == "fixed"] == first
    assert steps == [(5, 6), (6, 6)]


def test_other_metrics_are_measured_anew(evaluated, monkeypatch):
    """The journal of an evaluation without FLIP knows nothing of it."""
    evaluated([])
    monkeypatch.setattr(quality, "installed", lambda: ["flip-evaluator 99"])
    _, scored = evaluated([])
    assert len(scored) == 2


def test_a_view_with_an_empty_region_is_refused(tmp_path):
    tiny = EvaluationSettings(FrameSettings(fov_a=0.5, fov_b=0.1), SIZE, SIZE)
    with pytest.raises(UserError, match="region of this frame is empty"):
        evaluated_views([VIEW.resized(SIZE, SIZE)], references()[:1], tiny, tmp_path)
