"""Preparations from nothing, interrupted, and refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.errors import UserError
from hybrid.base.cache_folder import newest_forest
from hybrid.base.progress import no_bars
from hybrid.preparation import preparation as module
from hybrid.preparation import stage_planner as planner
from hybrid.preparation import stages
from hybrid.preparation.decisions import FIXED_GAUSSIANS, GAUSSIANS, REGION, SAMPLES
from hybrid.preparation.preparation import Beginning, Staged, prepare
from hybrid.preparation.stage_frames import VIEWS
from hybrid.preparation.stages import PreparationSettings
from hybrid.render.forest_attachments import errors_of, plan_of_forest, seconds_of
from pathtrace.dataset.captured_frames import read_frame
from pathtrace.dataset.frame_set import read_frame_set
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest
from tests.extremes import extreme
from tests.hybrid.preparation.tiny import STAGES, make_tiny, tiny_home
from tests.moving import moving_corner

pytestmark = pytest.mark.usefixtures("backend", "own_home")
DRAFT = PreparationSettings(quality="draft", held_out=2, size=(32, 32))


@pytest.fixture
def scene(monkeypatch):
    make_tiny(monkeypatch.setattr)
    return load_scene("cornell")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A scene, its preparation in one go, the folder of that, and the newest forest thereafter."""
    with tiny_home(tmp_path_factory.mktemp("home")):
        scene, folder = load_scene("cornell"), tmp_path_factory.mktemp("whole")
        prepared = prepare(scene, DRAFT, no_bars, folder)
        return scene, prepared, folder, newest_forest(scene)


def facts_without_times(facts):
    rows = [{name: row[name] for name in row if name != "seconds"} for row in facts["curve"]]
    return {**facts, "seconds": 0, "converging_seconds": 0, "curve": rows, "forest": ""}


def test_from_nothing_to_a_forest(whole):
    _, prepared, folder, newest = whole
    facts = prepared.facts
    assert (facts["scene"], facts["region"]) == ("cornell", "near")
    assert facts["spp"] == {"mean": 8, "least": 8, "most": 8}
    assert [row["gaussians"] for row in facts["curve"]][-1] == facts["gaussians"] <= 500
    assert 0 < facts["curve"][0]["seconds"] < facts["curve"][1]["seconds"] <= facts["seconds"]
    assert facts["splat"] == {name: facts["curve"][-1][name] for name in ("psnr", "ssim", "least_psnr")}
    assert facts["curve"][0]["psnr"] < facts["curve"][1]["psnr"]
    assert 10 < facts["frame_error_db"] < 60
    assert 10 < facts["trained_psnr"] < 60
    assert facts["limit"] in (SAMPLES, VIEWS, GAUSSIANS)
    assert len(read_frame_set(folder / "frames").training) == 6
    assert newest is not None
    assert {"frames", "held-out"} == {path.name for path in folder.iterdir() if path.is_dir()}
    assert prepared.forest.digest() == load_forest(folder / "forest.safetensors").digest()
    assert facts["curve"][-1]["seconds"] < seconds_of(prepared.forest) <= facts["seconds"]


@pytest.mark.parametrize(("region", "least", "most"), [("near", 250, 250), ("reachable", 251, 12 * 250)])
def test_gaussians_are_as_planned(scene, tmp_path, monkeypatch, region, least, most):
    """The plan is for the default region, with half as many as where nothing is known; others take more."""
    # Views and steps as well: up to 12 times as many.
    few = tuple(replace(stage, views=1, spp=2, steps=5) for stage in STAGES)
    monkeypatch.setattr(stages, "STAGES", few)
    plan = {GAUSSIANS: FIXED_GAUSSIANS // 2, SAMPLES: 64, REGION: "near"}
    settings = replace(DRAFT, region=region, held_out=0)
    prepared = prepare(replace(scene, plan=plan), settings, no_bars, tmp_path)
    found = plan_of_forest(prepared.forest)
    assert least <= found[GAUSSIANS] <= most
    assert least <= prepared.facts["gaussians"] <= most
    assert SAMPLES not in found


@extreme("a plan of one Gaussian", given="a preparation", expected="a forest of one Gaussian that is judged")
def test_one_gaussian(scene, tmp_path, got):
    plan = {GAUSSIANS: 1, REGION: "near"}
    facts = prepare(replace(scene, plan=plan), DRAFT, no_bars, tmp_path).facts
    got(f"{facts['gaussians']} Gaussian, {facts['splat']['psnr']:.1f} dB")
    assert facts["gaussians"] == 1
    assert np.isfinite(facts["splat"]["psnr"])


def test_further_stages_have_frames_of_a_higher_resolution(scene, tmp_path):
    """The finest layer is that of frames of 64 x 64 pixels; there is one layer more."""
    prepared = prepare(scene, replace(DRAFT, quality="standard"), no_bars, tmp_path)
    sizes = [entry.size for entry in read_frame_set(tmp_path / "frames").training]
    assert sizes == [(32, 32)] * 6 + [(64, 64)] * 2
    assert len(prepared.forest.counts) == 3
    assert prepared.forest.trained_focal == pytest.approx(scene.camera.resized(64, 64).fy)


@extreme(
    "a preparation interrupted in every part",
    given="Ctrl-C while frames are traced, while a forest is trained, and while it learns its errors",
    expected="the files of a preparation that was not interrupted",
)
def test_an_interrupted_preparation_resumes(scene, tmp_path, monkeypatch, whole, got):
    grow, train, learn = module.GrowingFrames.grow, module.train, module.with_errors
    interruptions = 0

    def once(name, owner, function):
        def interrupted(*given, **named):
            nonlocal interruptions
            monkeypatch.setattr(owner, name, function)
            interruptions += 1
            raise KeyboardInterrupt

        monkeypatch.setattr(owner, name, interrupted)

    for name, owner, function in (
        ("grow", module.GrowingFrames, grow),
        ("train", module, train),
        ("with_errors", module, learn),
    ):
        once(name, owner, function)
        with pytest.raises(KeyboardInterrupt):
            prepare(scene, DRAFT, no_bars, tmp_path / "other")
    resumed = prepare(scene, DRAFT, no_bars, tmp_path / "other")
    assert got(interruptions) == 3
    assert facts_without_times(resumed.facts) == facts_without_times(whole[1].facts)
    assert resumed.forest.digest() == whole[1].forest.digest()


@extreme(
    "a quality that cannot be reached",
    given="hybrid prepare --psnr 90",
    expected="a line that says what can be; the forest is kept",
)
def test_a_target_out_of_reach_is_refused_with_what_can_be_reached(scene, tmp_path, monkeypatch, got):
    monkeypatch.setattr(planner, "_MOST_STAGES", 1)
    with pytest.raises(UserError, match=r"90 dB cannot be reached; .* dB are") as refusal:
        prepare(scene, replace(DRAFT, psnr=90.0), no_bars, tmp_path)
    assert "\n" not in got(str(refusal.value))
    assert newest_forest(scene) is not None


def test_the_best_forest_is_kept_where_a_psnr_is_asked_for(scene, tmp_path, monkeypatch):
    quality, psnr = module.Judges.quality, iter((12.0, 15.0, 13.0))
    found = lambda judges, forest: quality(judges, forest) | {"psnr": next(psnr)}  # noqa: E731
    monkeypatch.setattr(module.Judges, "quality", found)
    with pytest.raises(UserError, match=r"15\.00 dB are"):
        prepare(scene, replace(DRAFT, psnr=90.0), no_bars, tmp_path)
    kept = newest_forest(scene)
    assert kept is not None
    means = [load_forest(tmp_path / f"stage-{number}.safetensors").finest.means for number in (1, 2)]
    assert [load_forest(kept).finest.means.equal(of_stage) for of_stage in means] == [True, False]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"quality": "best"}, "quality best: must be glimpse, draft, standard, high, live"),
        ({"minutes": 0.0}, "minutes 0: must be over 0"),
        ({"minutes": float("nan")}, "minutes nan"),
        ({"psnr": -1.0}, "psnr -1"),
        ({"minutes": 1.0, "psnr": 30.0}, "give one of them"),
        ({"psnr": 30.0, "held_out": 0}, "only be reached on held-out views"),
        ({"held_out": -1}, "held_out -1"),
        ({"most_indirect": 0.0}, "most_indirect 0: must be a radiance over 0"),
        ({"most_indirect": float("inf")}, "most_indirect inf"),
    ],
)
def test_settings_out_of_range_are_refused(given, message):
    with pytest.raises(UserError, match=message):
        PreparationSettings(**given)


@extreme(
    "a bound on nearly all indirect light",
    given="hybrid prepare --clamp-indirect 1e-6",
    expected="a forest, and the share of the radiance that is missing in its frames",
)
def test_bounded_light_is_missing_in_the_frames_and_stated(scene, tmp_path, got):
    # No time is left for a further stage, however quick the machine is.
    settings = replace(DRAFT, held_out=0, minutes=1e-6)
    free = prepare(scene, settings, no_bars, tmp_path / "free")
    assert free.facts["splat"] == {}  # without held-out views, nothing is judged
    assert [set(row) for row in free.facts["curve"]] == [{"seconds", "gaussians"}]
    bounded = prepare(scene, replace(settings, most_indirect=1e-6), no_bars, tmp_path / "bounded")
    assert free.facts["clamping_bias"] is None
    assert 0 < got(bounded.facts["clamping_bias"]) < 1
    frames = {name: (tmp_path / name / "frames").rglob("*-1.exr") for name in ("free", "bounded")}
    means = [np.mean([read_frame(file).radiance.mean() for file in files]) for files in frames.values()]
    assert means[1] < means[0]


def test_a_scene_that_moves_is_prepared_for_all_times(monkeypatch, tmp_path):
    """And again from what is there: the same forest."""
    make_tiny(monkeypatch.setattr)
    moving = moving_corner(tmp_path)
    prepared = prepare(moving, DRAFT, no_bars, tmp_path / "job")
    frames = read_frame_set(tmp_path / "job" / "frames")
    times = [entry.time for entry in frames.training]
    assert len(set(times)) == 6
    assert max(times) - min(times) > 0.6
    assert [course.name for course in frames.courses] == ["board"]
    forest = prepared.forest
    assert forest.motion is not None
    assert set(forest.nodes.semantic.tolist()) == {-1, 0}
    assert 5 < prepared.facts["splat"]["psnr"] < 60
    again = prepare(moving_corner(tmp_path), DRAFT, no_bars, tmp_path / "job")
    assert again.forest.digest() == forest.digest()


def test_a_glimpse_is_nobodys_newest_forest(scene):
    """It is kept in its folder, and knows nothing of its errors."""
    prepared = prepare(scene, PreparationSettings(quality="glimpse", held_out=0))
    assert errors_of(prepared.forest) is None
    assert newest_forest(scene) is None
    assert load_forest(prepared.facts["forest"]).digest() == prepared.forest.digest()
    assert len(prepared.facts["curve"]) == 1


def test_stages_are_told_while_a_forest_is_watched(scene, monkeypatch):
    """The newest forest is that of the third stage, and then that of the whole preparation."""
    told: list[Staged] = []
    stored: list[int] = []
    monkeypatch.setattr(module, "store_forest", lambda forest, name: stored.append(len(told)))
    prepare(scene, PreparationSettings(quality="live", held_out=0), told=told.append)
    assert [(one.number, one.stages) for one in told] == [(1, 3), (2, 3), (3, 3)]
    # The third stage, which is told after it was stored, and the end.
    assert stored == [2, 3]
    assert told[0].seconds < told[1].seconds < told[2].seconds
    forests = [load_forest(one.forest) for one in told]
    assert all(forest.scene_hash == scene.hash for forest in forests)
    assert all(errors_of(forest) is not None for forest in forests)
    assert 10 < told[0].psnr < told[2].psnr


def test_stages_of_mostly_new_views_are_trained_from_these_alone(scene, tmp_path, monkeypatch):
    """The second of three; the last one goes on from it."""
    first = replace(STAGES[0], views=2, scale=0.5)
    monkeypatch.setitem(stages.QUALITIES, "live", (first, *STAGES[:2]))
    starts: list[bool] = []

    def train(*given, start=None, **named):
        starts.append(start is not None)
        return trained(*given, start=start, **named)

    trained = module.train
    monkeypatch.setattr(module, "train", train)
    prepare(scene, PreparationSettings(quality="live", held_out=0), no_bars, tmp_path)
    assert starts == [False, False, True]
    sizes = [entry.size for entry in read_frame_set(tmp_path / "frames").training]
    assert sizes == [(16, 16)] * 2 + [(32, 32)] * 6


def test_a_preparation_goes_on_from_a_forest(scene, tmp_path, monkeypatch, whole):
    """Its first stage is better than from nothing; resumed without the forest, it is the same."""
    monkeypatch.setitem(stages.QUALITIES, "draft", (replace(STAGES[0], steps=5), STAGES[1]))
    start = whole[1].forest
    settings = replace(DRAFT, seed=3)
    told: list[Staged] = []
    begun = prepare(
        scene, settings, no_bars, tmp_path / "begun", beginning=Beginning(start), told=told.append
    )
    anew: list[Staged] = []
    prepare(scene, settings, no_bars, tmp_path / "anew", told=anew.append)
    assert told[0].psnr > anew[0].psnr + 0.3
    for file in (tmp_path / "begun").glob("*forest*"):
        file.unlink()
    again = prepare(scene, settings, no_bars, tmp_path / "begun")
    assert again.forest.digest() == begun.forest.digest()
