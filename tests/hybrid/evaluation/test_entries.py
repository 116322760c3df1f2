"""What an evaluation compares, its quality and its times."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode
from compose.image.colour import bytes_from_radiance
from hybrid.base.progress import no_progress
from hybrid.evaluation.entries import (
    OTHER_SPP,
    Entry,
    EvaluatedView,
    baseline_entries,
    hybrid_entries,
    quality_rows,
    splat_entries,
    time_rows,
    timed,
)
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.evaluation.results import OURS
from hybrid.evaluation.scoring import ScoringTask
from hybrid.evaluation.verdicts import MARGINS
from hybrid.measure.frame_quality import METRICS
from hybrid.measure.image_metrics import regions
from hybrid.measure.reference import Reference
from hybrid.render.frame_settings import FrameSettings
from tests import small
from tests.hybrid.evaluation.fakes import CAMERA, VIEW, Costly, Recorder


def made(rays: float, met: float | None, least: float = 0.0) -> list[Entry]:
    """Entries of one family, of which `met` rays take our time."""
    family = lambda count: Costly(max(least, count), 0.0, 1.0)  # noqa: E731
    return baseline_entries({"full": family}, {"full": met}, rays, CAMERA, Gaze())


def test_a_baseline_that_meets_both_budgets_stands_in_both_rows():
    at_rays, at_time = made(2.0, 4.0)
    assert [at_rays.key, at_time.key] == [("full", "equal-rays"), ("full", "equal-time")]
    assert at_rays.method.rays(CAMERA, Gaze()) == 2
    assert at_time.method.rays(CAMERA, Gaze()) == 4
    assert (at_rays.briefly, at_time.briefly) == (True, False)


@pytest.mark.parametrize(("least", "budget"), [(2.1, "equal-rays"), (2.11, "fixed")])
def test_a_baseline_that_takes_more_rays_at_its_cheapest_is_there_at_those(least, budget):
    """Up to 5 % more count as equal."""
    first, second = made(2.0, 4.0, least)
    assert first.budget == budget
    assert first.method.rays(CAMERA, Gaze()) == least
    assert second.budget == "equal-time"


def test_a_baseline_that_always_takes_longer_is_not_there_at_equal_time():
    assert [entry.budget for entry in made(2.0, None)] == ["equal-rays"]


@pytest.mark.parametrize("spp", [1, 3])
def test_hybrid_frames_have_all_foveas_and_fused_ones_further_samples(spp):
    settings = EvaluationSettings(FrameSettings(fov_a=30, fov_b=10, spp=spp))
    entries = hybrid_entries(None, settings)
    assert entries[:3] == hybrid_entries(None, replace(settings, quick=True))
    by_name = {entry.name: entry for entry in entries}
    assert list(by_name)[:3] == ["hybrid, raw", "hybrid, denoised", "hybrid, fused"]
    for mode in FoveaMode:
        used = by_name[f"hybrid, {mode.value}"]
        assert used.method.settings == {"fovea": mode.value, "spp": spp, "fov_a": 30, "fov_b": 10}
        assert not used.briefly
    others = {entry.method.settings["spp"]: entry for entry in entries[3:]}
    assert set(others) == set(OTHER_SPP) - {spp}
    for count, entry in others.items():
        assert entry.name == f"{OURS}, {count} spp"
        assert entry.method.settings["fovea"] == "fused"
        assert entry.briefly
    assert {entry.budget for entry in entries} == {"fixed"}


def test_splats_without_trees_are_there_if_given():
    forest, flat = Costly(0.0, 1.0, 0.0), Costly(0.0, 2.0, 0.0)
    assert [entry.name for entry in splat_entries(forest, None)] == ["splats alone"]
    first, second = splat_entries(forest, flat)
    assert (first.name, first.method) == ("splats alone", forest)
    assert (second.name, second.method, second.budget) == ("3dgs, no forest", flat, "fixed")


SIZE = 32
SETTINGS = EvaluationSettings(FrameSettings((0.5, 0.5), 30, 15), SIZE, SIZE, seeds=2, repeats=8, seed=5)


def reference() -> Reference:
    halves = tuple(small.rng(n).uniform(0.2, 0.8, (SIZE, SIZE, 3)).astype(np.float32) for n in range(2))
    return Reference(0.5 * (halves[0] + halves[1]), halves, np.zeros((SIZE, SIZE), np.float32))


def shown(number: int = 1, is_shown: bool = True, **settings: int) -> EvaluatedView:
    truth = reference()
    parts = regions(SETTINGS.frame.foveation, truth.radiance)
    view = VIEW.resized(SIZE, SIZE)
    return EvaluatedView(number, "near", view, truth, parts, replace(SETTINGS, **settings), is_shown)


def scored_as(tasks: list[ScoringTask]):
    """Scores by the mean brightness, and keeps the tasks."""

    def scored(given):
        for task in given:
            tasks.append(task)
            yield [{"region": "whole", "metric": "psnr", "value": float(task.image.mean())}]

    return scored


def quality(entries: list[Entry], at: EvaluatedView, folder) -> tuple[list[dict], list[ScoringTask]]:
    tasks: list[ScoringTask] = []
    return quality_rows(entries, at, folder, scored_as(tasks), no_progress), tasks


def test_rows_have_view_and_seed_and_brief_entries_the_first_seed_only(tmp_path):
    traced, brief = (
        Entry("full", "equal-time", Recorder(1)),
        Entry("brief", "fixed", Recorder(1), briefly=True),
    )
    splats = Entry("splats alone", "fixed", Recorder(0))
    rows, _ = quality([traced, brief, splats], shown(), tmp_path)
    assert [(row["seed"], row["method"]) for row in rows] == [
        (0, "full"),
        (0, "brief"),
        (0, "splats alone"),
        (1, "full"),
    ]
    assert rows[0] == {
        "view": 1,
        "seed": 0,
        "method": "full",
        "budget": "equal-time",
        "region": "whole",
        "metric": "psnr",
        "value": 0.5,
    }


def test_frames_are_compared_in_all_regions_and_further_ones_in_those_that_decide(tmp_path):
    traced, brief = (
        Entry("full", "equal-time", Recorder(1)),
        Entry("brief", "fixed", Recorder(1), briefly=True),
    )
    _, (first, of_brief, second) = quality([traced, brief], shown(), tmp_path)
    np.testing.assert_array_equal(first.reference, reference().radiance)
    assert first.flip_file.name == "1-full-equal-time-flip.png"
    assert second.flip_file is None
    assert set(first.regions) == {"whole", "foveal", "seam", "peripheral", "salient"}
    assert set(of_brief.regions) == {"whole", "foveal", "peripheral"}
    assert set(second.regions) == {"whole", "foveal"}
    assert set(first.metrics) == set(METRICS)
    assert set(of_brief.metrics) == set(second.metrics) == set(MARGINS)
    assert first.method == "full"
    assert first.viewer.gaze == SETTINGS.frame.gaze
    assert first.viewer.display == SETTINGS.frame.display


def test_images_are_kept_of_views_that_are_shown(tmp_path):
    from PIL import Image as PillowImage

    _, tasks = quality([Entry("full", "fixed", Recorder(1))], shown(2, is_shown=False), tmp_path)
    assert not list(tmp_path.iterdir())
    assert tasks[0].flip_file is None
    quality([Entry("full", "fixed", Recorder(1))], shown(), tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"1-full-fixed.png", "1-reference.png"}
    found = np.asarray(PillowImage.open(tmp_path / "1-reference.png"))
    np.testing.assert_array_equal(found, bytes_from_radiance(reference().radiance))


def test_views_and_seeds_have_noise_of_their_own_and_the_gaze_of_the_settings(tmp_path):
    seeds = []
    for number in range(2):
        method = Recorder(1)
        quality([Entry("full", "fixed", method)], shown(number), tmp_path)
        assert method.gazes == [SETTINGS.frame.gaze] * 2
        seeds += method.seeds
    assert seeds == [5, 6, 7, 8]


def passes(entries: list[Entry], **settings: int) -> list[dict]:
    return timed(entries, shown(**settings), no_progress)


def test_all_take_turns_along_one_path_and_brief_entries_have_three_frames_of_it():
    whole, brief = Recorder(1), Recorder(2)
    entries = [Entry("whole", "fixed", whole), Entry("brief", "fixed", brief, briefly=True)]
    first, second = passes(entries, repeats=120)
    assert first == {
        "method": "whole",
        "budget": "fixed",
        "passes": {"trace": [1.0] * 120, "total": [1.0] * 120},
    }
    assert second["passes"]["total"] == [2.0] * 3
    # The first frame warms up.
    assert (len(whole.gazes), len(brief.gazes)) == (121, 4)
    x, y = (np.array([getattr(gaze, axis) for gaze in whole.gazes]) for axis in "xy")
    np.testing.assert_allclose([x.min(), x.max()], [0.35, 0.65], atol=0.01)
    np.testing.assert_allclose([y.min(), y.max()], [0.35, 0.65], atol=0.01)
    assert len({(gaze.x, gaze.y) for gaze in brief.gazes[1:]}) == 3


def test_slow_methods_end_after_four_seconds_but_not_before_three_frames():
    """Frames of 1, 1.5 and 4 seconds: four seconds are over after 4 and 3; they must be exceeded."""
    methods = [Recorder(1000 * seconds) for seconds in (1, 1.5, 4)]
    found = passes([Entry(f"{m.spp}", "fixed", m) for m in methods])
    assert [len(row["passes"]["total"]) for row in found] == [5, 3, 3]


def test_no_two_frames_in_turn_have_the_same_camera():
    one, other = Recorder(1), Recorder(2)
    passes([Entry("one", "fixed", one), Entry("other", "fixed", other)])
    assert not {camera.key for camera in one.cameras} & {camera.key for camera in other.cameras}
    keys = [camera.key for camera in one.cameras]
    assert all(a != b for a, b in pairwise(keys))
    corner = np.array([[0.0, 0.0, 5.0]])
    moved = [camera.project(corner)[0] for camera in one.cameras]
    assert np.abs(np.array(moved) - shown().view.camera.project(corner)[0]).max() < 0.01


def of_view(**totals: list[float]) -> list[dict]:
    """What was timed in a view, of entries by name; `ours` is our frame."""
    names = {"ours": OURS}
    return [
        {
            "method": names.get(name, name),
            "budget": "fixed",
            "passes": {"trace": [1.0] * len(of), "total": of},
        }
        for name, of in totals.items()
    ]


def test_views_are_compared_with_ours_one_by_one():
    """Times double from view to view; the other method is a fifth slower in one, a tenth in the other."""
    first = of_view(ours=[10.0, 10.0, 30.0], other=[12.0, 12.0, 12.0])
    second = of_view(ours=[20.0, 20.0, 20.0], other=[22.0, 22.0])
    ours, other = time_rows([first, second], 8, 6)
    assert ours["over_ours"] == 1
    assert ours["over_ours_range"] == [1, 1]
    assert other["over_ours_range"] == [pytest.approx(1.1), pytest.approx(1.2)]
    assert other["over_ours"] == pytest.approx(np.sqrt(1.1 * 1.2))
    assert other["ms_range"] == [12, 22]
    assert (other["ms"], other["repeats"], other["passes"]) == ({"p50": 12.0}, 5, {"trace": 1.0})
    assert (other["method"], other["budget"], other["width"], other["height"]) == ("other", "fixed", 8, 6)


def test_a_method_may_be_missing_in_a_view():
    """The cheapest frame of a baseline may take longer than ours in some views."""
    rows = time_rows([of_view(ours=[10.0]), of_view(ours=[20.0], other=[10.0])], 8, 8)
    assert rows[1]["over_ours_range"] == [0.5, 0.5]
    assert rows[1]["repeats"] == 1


@pytest.mark.parametrize(
    ("repeats", "known"),
    [
        (19, ["p50"]),
        (20, ["p50", "p95"]),
        (99, ["p50", "p95"]),
        (100, ["p50", "p95", "p99"]),
    ],
)
def test_a_percentile_needs_enough_frames(repeats, known):
    assert list(time_rows([of_view(ours=[1.0] * repeats)], 8, 8)[0]["ms"]) == known
