"""What an evaluation compares, its quality and its times."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode
from compose.image.colour import bytes_from_radiance
from hybrid.base.identity import Journal
from hybrid.evaluation import entries as quality
from hybrid.evaluation.entries import (
    OTHER_SPP,
    Entry,
    baseline_entries,
    evaluated_views,
    hybrid_entries,
    quality_rows,
    splat_entries,
    time_rows,
)
from hybrid.evaluation.evaluation_settings import EvaluationSettings
from hybrid.evaluation.results import HALVES, OURS, Key
from hybrid.measure.reference import Reference
from hybrid.render.frame_settings import FrameSettings
from tests import small
from tests.hybrid.evaluation.fakes import CAMERA, VIEW, Costly, Recorder


def made(tmp_path, per_ray: float, least: float = 0.0, fixed: float = 0.0) -> list[Entry]:
    """Entries of one family beside ours, which takes 200 ms for 2 rays."""
    ours = Entry(OURS, "fixed", Costly(2.0, 0.0, 100.0))
    family = lambda rays: Costly(max(least, rays), fixed, per_ray)  # noqa: E731
    costs = Journal(tmp_path / "costs.json", {})
    return baseline_entries(ours, {"full": family}, [VIEW], Gaze(), costs, lambda done, total: None)


def test_a_baseline_that_meets_both_budgets_stands_in_both_rows(tmp_path):
    found = made(tmp_path, 100.0)
    assert [entry.key for entry in found] == [("full", "equal-rays"), ("full", "equal-time")]
    assert found[0].method.settings == found[1].method.settings


def test_a_cheaper_baseline_gets_more_rays_at_equal_time(tmp_path):
    at_rays, at_time = made(tmp_path, 50.0)
    assert at_rays.method.rays(CAMERA, Gaze()) == 2
    assert 3.8 < at_time.method.rays(CAMERA, Gaze()) < 4.2
    assert (at_rays.briefly, at_time.briefly) == (True, False)


@pytest.mark.parametrize(("least", "budget", "briefly"), [(2.05, "equal-rays", True), (2.2, "fixed", False)])
def test_a_baseline_that_takes_more_rays_at_its_cheapest_is_there_at_those(tmp_path, least, budget, briefly):
    """Up to 3 % more count as equal."""
    first, second = made(tmp_path, 50.0, least)
    assert (first.budget, first.briefly) == (budget, briefly)
    assert first.method.rays(CAMERA, Gaze()) == least
    assert second.budget == "equal-time"


def test_a_baseline_that_always_takes_longer_is_not_there_at_equal_time(tmp_path):
    assert [entry.budget for entry in made(tmp_path, 50.0, fixed=300.0)] == ["equal-rays"]


def test_rays_of_equal_time_are_found_once(tmp_path):
    """The same baseline is compared ever after, even if it has become quicker since."""
    first = made(tmp_path, 50.0)[1].method.settings
    assert made(tmp_path, 25.0)[1].method.settings == first


def test_entries_of_other_settings_have_other_titles():
    one, other = (Entry("full", "equal-time", Costly(rays, 0.0, 1.0)) for rays in (1.0, 2.0))
    assert one.title != other.title
    assert one.title == Entry("full", "equal-time", Costly(1.0, 5.0, 1.0)).title
    assert one.title != Entry("full", "fixed", Costly(1.0, 0.0, 1.0)).title
    assert one.key == Key("full", "equal-time")


@pytest.mark.parametrize("spp", [1, 3])
def test_hybrid_frames_have_all_foveas_and_fused_ones_further_samples(spp):
    settings = EvaluationSettings(FrameSettings(fov_a=30, fov_b=10, spp=spp))
    entries = hybrid_entries(None, settings)
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


def rows(entries: list[Entry], journal: Journal, repeats: int = 120, gaze: Gaze | None = None) -> list[dict]:
    gaze = gaze or Gaze(0.4, 0.6)
    return time_rows(entries, [VIEW], gaze, repeats, journal, lambda done, total: None)


@pytest.fixture
def journal(tmp_path) -> Journal:
    return Journal(tmp_path / "j.json", {})


def test_brief_entries_see_the_whole_path_and_have_no_99th_percentile(journal):
    whole, brief = Recorder(1), Recorder(2)
    entries = [Entry("whole", "fixed", whole), Entry("brief", "fixed", brief, briefly=True)]
    first, second = rows(entries, journal)
    assert (first["repeats"], second["repeats"]) == (120, 20)
    assert list(first["ms"]) == ["p50", "p95", "p99"]
    assert list(second["ms"]) == ["p50", "p95"]
    for seen in (whole, brief):
        x, y = (np.array([getattr(gaze, axis) for gaze in seen.gazes]) for axis in "xy")
        # The path leads around the gaze of the evaluation.
        np.testing.assert_allclose([x.min(), x.max()], [0.25, 0.55], atol=0.01)
        np.testing.assert_allclose([y.min(), y.max()], [0.45, 0.75], atol=0.01)


@pytest.mark.parametrize(
    ("repeats", "known"),
    [
        (19, ["p50"]),
        (20, ["p50", "p95"]),
        (99, ["p50", "p95"]),
        (100, ["p50", "p95", "p99"]),
    ],
)
def test_a_percentile_needs_enough_frames(journal, repeats, known):
    assert list(rows([Entry("one", "fixed", Recorder(1))], journal, repeats)[0]["ms"]) == known


def test_the_path_stays_in_the_frame(journal):
    seen = Recorder(1)
    rows([Entry("one", "fixed", seen)], journal, gaze=Gaze(0.05, 1.0))
    assert {min(gaze.x for gaze in seen.gazes), max(gaze.y for gaze in seen.gazes)} == {0.0, 1.0}


def test_rows_have_medians_of_passes_and_what_was_timed(journal):
    (row,) = rows([Entry("one", "equal-time", Recorder(7))], journal, 20)
    assert row == {
        "method": "one",
        "budget": "equal-time",
        "width": 8,
        "height": 8,
        "ms": {"p50": 7.0, "p95": 7.0},
        "passes": {"trace": 1.0},
        "repeats": 20,
    }


def test_slow_methods_end_after_80_seconds_but_not_before_20_frames(journal):
    """Frames of 2, 5 and 10 seconds: 80 seconds are over after 40 and 16; they must be exceeded."""
    seconds = (2, 5, 10)
    methods = [Recorder(1000 * time) for time in seconds]
    found = rows([Entry(f"{m.spp}", "fixed", m) for m in methods], journal, 60)
    assert [row["repeats"] for row in found] == [41, 20, 20]


def test_frames_that_warm_up_do_not_count(journal):
    seen = Recorder(1)
    rows([Entry("one", "fixed", seen)], journal, 20)
    assert len(seen.gazes) == 20 + 5


def test_no_two_frames_in_turn_have_the_same_camera(journal):
    one, other = Recorder(1), Recorder(2)
    rows([Entry("one", "fixed", one), Entry("other", "fixed", other)], journal)
    assert not {camera.key for camera in one.cameras} & {camera.key for camera in other.cameras}
    keys = [camera.key for camera in one.cameras]
    assert all(a != b for a, b in pairwise(keys))
    corner = np.array([[0.0, 0.0, 5.0]])
    moved = [camera.project(corner)[0] for camera in one.cameras]
    assert np.abs(np.array(moved) - CAMERA.project(corner)[0]).max() < 0.01


def test_times_of_another_setting_are_not_taken_over(tmp_path):
    file = tmp_path / "j.json"
    rows([Entry("full", "equal-time", Recorder(3))], Journal(file, {}), 20)
    again = Recorder(3)
    assert rows([Entry("full", "equal-time", again)], Journal(file, {}), 20)[0]["ms"]["p50"] == 3
    assert not again.gazes
    assert rows([Entry("full", "equal-time", Recorder(5))], Journal(file, {}), 20)[0]["ms"]["p50"] == 5


def test_an_interrupted_timing_resumes(tmp_path):
    """Times are saved every ten rounds."""
    file, seen = tmp_path / "j.json", Recorder(1)

    def interrupted(done: int, total: int) -> None:
        if done == 14:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        time_rows([Entry("one", "fixed", seen)], [VIEW], Gaze(), 30, Journal(file, {}), interrupted)
    rest = Recorder(1)
    assert rows([Entry("one", "fixed", rest)], Journal(file, {}), 30)[0]["repeats"] == 30
    assert len(rest.gazes) == 20 + 5


def test_frames_go_through_the_views_and_are_compared_with_ours(journal):
    """Ours take 10 ms, and the baseline 12: it is a fifth slower over the frames that both have."""
    views = [VIEW, VIEW.resized(8, 8), VIEW.resized(16, 8)]
    ours, other, brief = Recorder(10), Recorder(12), Recorder(5)
    entries = [
        Entry(OURS, "fixed", ours),
        Entry("full", "equal-time", other),
        Entry("brief", "fixed", brief, briefly=True),
    ]
    found = time_rows(entries, views, Gaze(), 60, journal, lambda done, total: None)
    assert [row["over_ours"] for row in found] == [1, pytest.approx(1.2), 0.5]
    assert [row["ms_range"] for row in found] == [[10, 10], [12, 12], [5, 5]]
    for method, count in ((ours, 60), (other, 60), (brief, 20)):
        seen = [camera.width for camera in method.cameras[5:]]
        assert seen == [8, 8, 16] * (count // 3) + [8, 8][: count % 3]
