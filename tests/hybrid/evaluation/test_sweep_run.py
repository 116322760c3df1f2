"""Sweeps from their names to rows, and what is stored with these."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.camera import View
from compose.eye.gaze import Gaze
from hybrid.base.cache_folder import home
from hybrid.base.identity import Journal, short_hash
from hybrid.evaluation import baselines_traced as path_traced
from hybrid.evaluation import sweep_catalogue as catalogue
from hybrid.evaluation import sweep_run as module
from hybrid.evaluation.methods import HybridMethod
from hybrid.evaluation.sweep_catalogue import FPC_FIGURE_14, SWEEPS, Setting, SweepEffort, sweep_named
from hybrid.evaluation.sweep_run import identity_of, quality_of, regions_of, settings_of_row, sweep, swept
from hybrid.measure.image_metrics import psnr
from hybrid.measure.reference import Reference
from hybrid.render import periphery as saliency
from pathtrace.region.neighbourhood import unseen_views
from tests.extremes import extreme
from tests.hybrid.command import run
from tests.hybrid.forests import white_dot

pytestmark = pytest.mark.usefixtures("backend", "own_home", "quick_metrics")
EFFORT = SweepEffort(3, 1, 4)


def rows(base: Setting, **changes: list) -> list[Setting]:
    """One row per value of a frame setting."""
    ((name, values),) = changes.items()
    return [replace(base, frame=replace(base.frame, **{name: v}), varied={name: v}) for v in values]


@pytest.fixture
def measure(corner, rough, tmp_path):
    """Measures rows; steps of progress are kept."""
    steps = []

    def run(settings, with_quality=False, name="journal"):
        journal = Journal(tmp_path / f"{name}.json", {})
        found = swept(
            corner, rough, settings, with_quality, EFFORT, journal, lambda *step: steps.append(step)
        )
        return found, steps

    return run


def test_ratios_are_to_the_full_frame_with_as_many_samples(base, measure, monkeypatch):
    """Hybrid frames of 1 and 2 samples take 10 and 20 ms, full ones 40 and 100 ms."""
    timed = []

    def made_up(methods, repeats, warm_up, progress, reach):
        timed.append((len(methods), repeats, warm_up, reach))
        fixed = [10.0, 20.0, 40.0, 100.0]
        return [[{"trace": 0.5 * ms, "total": ms + n} for n in (-1, 0, 5)] for ms in fixed]

    monkeypatch.setattr(module, "interleaved_passes", made_up)
    settings = [replace(one, over_one_spp=True, paper={"ratio": 7.0}) for one in rows(base, spp=[1, 2])]
    first, second = measure(settings)[0]
    assert (first["ratio"], second["ratio"]) == (4.0, 5.0)
    assert (first["ratio_1spp"], second["ratio_1spp"]) == (4.0, 2.0)
    assert (first["ms"]["p50"], first["full_ms"]["p50"], second["full_ms"]["p50"]) == (10, 40, 100)
    assert first["passes"] == {"trace": 5.0}
    assert first["ratio_interval"][0] <= 4 <= first["ratio_interval"][1]
    assert first["paper"] == {"ratio": 7.0}
    assert (first["spp"], second["spp"]) == (1, 2)
    assert timed == [(4, 3, 1, (0.15, 0.15))]


def test_full_frames_are_denoised_where_the_fovea_is(base, measure, monkeypatch):
    traced = []
    full = module.FullTrace
    monkeypatch.setattr(module, "FullTrace", lambda tracer, *how: (traced.append(how), full(tracer, *how))[1])
    measure(rows(replace(base, over_one_spp=True, frame=replace(base.frame, spp=2)), fovea=["raw", "fused"]))
    assert set(traced) == {(2, False), (2, True), (1, False), (1, True)}


def test_rows_have_all_passes_and_what_their_discs_cover(base, measure):
    found, steps = measure(rows(base, fov_a=[40.0, 90.0]))
    for row in found:
        assert {"region", "detail", "splat", "fill", "trace", "fovea", "blend"} == set(row["passes"])
        assert row["ratio"] == pytest.approx(row["full_ms"]["p50"] / row["ms"]["p50"])
        assert row["repeats"] == 3
        assert "paper" not in row
        assert "ratio_1spp" not in row
        assert "quality" not in row
    # 0.4^2 pi / 1.5 of the frame; the larger disc loses its top, its bottom and its sides.
    assert found[0]["covered"] == pytest.approx(0.335, abs=0.01)
    assert found[1]["covered"] == pytest.approx(0.99, abs=0.02)
    assert steps[-1] == (2000, 2000)
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)


def test_every_timed_frame_has_a_camera_of_its_own(base, measure, monkeypatch):
    cameras = []
    hybrid, full = module.HybridMethod.render, module.FullTrace.render
    for kind, render in ((module.HybridMethod, hybrid), (module.FullTrace, full)):
        monkeypatch.setattr(
            kind,
            "render",
            lambda self, view, *rest, render=render: (
                cameras.append(view.camera.key),
                render(self, view, *rest),
            )[1],
        )
    measure(rows(base, fov_a=[40.0, 90.0]))
    assert len(cameras) == len(set(cameras)) == 3 * (3 + 1)
    assert base.camera.key not in cameras


def test_quality_is_measured_where_wanted(base, measure):
    clean = replace(base, frame=replace(base.frame, spp=64))
    found, _ = measure(rows(clean, fov_a=[30.0, 60.0]), with_quality=True)
    for row in found:
        assert 0 < row["quality"]["foveal ssim"] <= 1
        assert row["quality"]["peripheral psnr"] > 5
    # A larger disc leaves less of the frame to rough splats.
    assert found[1]["quality"]["whole psnr"] > found[0]["quality"]["whole psnr"]


def test_an_empty_region_is_refused_before_anything_is_timed(base, measure, monkeypatch):
    def forbidden(*_):
        raise AssertionError("timed")

    monkeypatch.setattr(module, "interleaved_passes", forbidden)
    settings = rows(replace(base, frame=replace(base.frame, fov_b=0.0)), fov_a=[30.0, 0.1])
    with pytest.raises(UserError, match="the foveal region of this frame is empty"):
        measure(settings, with_quality=True)


def test_rows_of_one_camera_take_turns_and_are_saved_together(base, measure, monkeypatch):
    timed = []
    passes = module.interleaved_passes

    def counted(methods, *rest):
        timed.append(len(methods))
        return passes(methods, *rest)

    monkeypatch.setattr(module, "interleaved_passes", counted)
    first = rows(base, fov_a=[20.0, 40.0])
    other = rows(replace(base, camera=base.camera.resized(36, 24)), fov_a=[20.0, 40.0])
    found, _ = measure(first + other)
    # Two hybrid methods and the full frame that both are compared with.
    assert timed == [3, 3]
    assert [row["fov_a"] for row in found] == [20, 40, 20, 40]
    assert measure(first + other)[0] == json.loads(json.dumps(found))
    assert timed == [3, 3]


# What a sweep's file has beside the settings that its rows have in common.
CONTENT = {"scene", "forest", "over", "title", "views", "rows", "break_even", "machine"}


@pytest.fixture
def written(made, monkeypatch, tmp_path):
    """Runs a sweep over small frames and returns what it wrote."""
    monkeypatch.setattr(catalogue, "FPC_BREAK_EVEN", {(48, 32): 51.0, (64, 32): 50.0})
    monkeypatch.setattr(catalogue, "FPC_VIEW_SIZES", ((48, 32),))
    monkeypatch.setattr(catalogue, "FPC_FIGURE_14_SIZE", (48, 32))
    monkeypatch.setattr(catalogue, "FPC_FIGURE_14_RADII", (10, 90))
    for spp in (4, 6):
        monkeypatch.delitem(FPC_FIGURE_14, spp)
    monkeypatch.setattr(catalogue, "_RADII", (20, 90))
    monkeypatch.setattr(catalogue, "_BAND_OUTER", (40.0,))

    def sweep(over: str, *options: object) -> dict:
        out = tmp_path / f"{over}.json"
        common = ["sweep", "cornell", "--forest", made / "box.forest", "--repeats", 3, "--warm-up", 1]
        assert run(monkeypatch, *common, "--over", over, "--json", out, *options) == 0
        return json.loads(out.read_text())

    return sweep


def check(row: dict) -> None:
    assert row["ratio"] == pytest.approx(row["full_ms"]["p50"] / row["ms"]["p50"])
    assert {"detail", "splat", "trace", "fovea", "blend"} <= set(row["passes"])
    assert 0 < row["covered"] <= 1
    assert row["repeats"] == 3


def test_radius_has_a_row_per_size_and_radius_and_tells_where_it_breaks_even(written, capsys):
    found = written("radius")
    keys = [(row["width"], row["height"], row["radius"]) for row in found["rows"]]
    assert keys == [(w, 32, r) for w in (48, 64) for r in (20, 90)]
    for row in found["rows"]:
        check(row)
    assert [(row["width"], row["paper"]) for row in found["break_even"]] == [(48, 51.0), (64, 50.0)]
    assert [row["covered"] for row in found["rows"]] == pytest.approx([0.084, 0.99, 0.063, 0.93], rel=0.1)
    shown = capsys.readouterr().out.splitlines()
    assert "covered, %" in shown[1]
    assert f"{100 * found['rows'][0]['covered']:.1f}" in shown[2].split()


def test_every_timed_frame_pays_for_what_its_camera_shows(written, monkeypatch):
    """Rows share renderers, which keep what depends on the camera alone: saliency, for one."""
    features, cameras = [], set()
    look, trace = saliency.saliency, path_traced.PathTraced.traced

    def counted(image):
        features.append(image.shape)
        return look(image)

    def traced(method, camera, *rest):
        cameras.add(camera.key)
        return trace(method, camera, *rest)

    monkeypatch.setattr(saliency, "saliency", counted)
    monkeypatch.setattr(path_traced.PathTraced, "traced", traced)
    rows = written("radius")["rows"]
    assert len(features) == len(rows) * (3 + 1)
    assert len(cameras) == 2 * (3 + 1)


@pytest.mark.parametrize("fovea", ["raw", "denoised"])
def test_samples_are_compared_with_one_sample_as_well(written, capsys, fovea):
    """As in Foveated Path Culling's Figure 14: its frame rate over that of its path tracing at 1 sample."""
    found = written("spp", "--fovea", fovea)["rows"]
    assert [(row["spp"], row["radius"]) for row in found] == [(n, r) for n in (1, 2) for r in (10, 90)]
    one = found[0]["full_ms"]["p50"]
    for row in found:
        check(row)
        assert row["ratio_1spp"] == pytest.approx(one / row["ms"]["p50"])
    assert [row["paper"] for row in found] == [{"ratio_1spp": fps / 150} for fps in (200, 100, 192, 67)]
    shown = capsys.readouterr().out
    assert "ratio to 1 spp  FPC's ratio to 1 spp" in shown.splitlines()[1]
    assert [line.split()[-1] for line in shown.splitlines()[2:6]] == ["1.33", "0.67", "1.28", "0.45"]


def test_sweeps_with_quality_have_it_in_each_row(written):
    found = written("band", "--size", 48, 40, "--reference-spp", 4, "--fovea", "fused")
    assert [row["fov_b"] for row in found["rows"]] == [10, 20, 30, 40]
    for row in found["rows"]:
        check(row)
        assert 0 < row["quality"]["foveal ssim"] <= 1
        assert row["quality"]["peripheral psnr"] > 5


def test_views_are_other_ones_than_the_scenes(written):
    assert len({row["view"] for row in written("view")["rows"]}) == 4


def test_layers_have_their_gaussians(written):
    layers = written("layers", "--size", 48, 40, "--reference-spp", 4)["rows"]
    assert [row["layers"] for row in layers] == ["1 to 1", "1 to 2", "2 to 2"]
    assert layers[0]["gaussians"] < layers[1]["gaussians"]


def test_an_interrupted_sweep_resumes(written, monkeypatch, tmp_path):
    """Sizes that were measured are kept, others and those of other settings are measured."""
    timed, times = module.interleaved_passes, []

    def interrupted(*arguments):
        if len(times) == 1:
            raise KeyboardInterrupt
        times.append(timed(*arguments))
        return times[-1]

    monkeypatch.setattr(module, "interleaved_passes", interrupted)
    with pytest.raises(AssertionError, match="130"):
        written("radius")
    (kept,) = home().glob("*/sweep-radius-*.json")
    first = json.loads(kept.read_text())["results"]["0"]

    def counted(*arguments):
        times.append(timed(*arguments))
        return times[-1]

    monkeypatch.setattr(module, "interleaved_passes", counted)
    written("radius", "--spp", 2)
    assert len(times) == 3
    assert kept.exists()
    rows = written("radius")["rows"]
    assert len(times) == 4
    assert rows[:2] == first
    assert [(row["width"], row["radius"]) for row in rows] == [(w, r) for w in (48, 64) for r in (20, 90)]
    assert not list(home().glob("*/sweep-*"))


def test_a_seam_whose_quality_is_not_measured_may_be_empty(written):
    size = ["--size", 48, 40, "--reference-spp", 4]
    rows = written("acuity", *size, "--fov-a", 25, "--fov-b", 24.99)["rows"]
    assert all("foveal ssim" in row["quality"] for row in rows)


def test_an_empty_fovea_is_refused_before_anything_is_timed(made, monkeypatch, capsys):
    def forbidden(*_):
        raise AssertionError("timed")

    monkeypatch.setattr(module, "interleaved_passes", forbidden)
    command = ["sweep", "cornell", "--forest", made / "box.forest", "--over", "acuity", "--size", 48, 40]
    assert run(monkeypatch, *command, "--reference-spp", 4, "--fov-a", 0.1, "--fov-b", 0.05) == 2
    assert "the foveal region of this frame is empty" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("over", "option"),
    [
        *((over, "--size 48 32") for over in ("resolution", "aspect", "radius", "spp", "view")),
        *((over, "--spp 2") for over in ("spp", "denoiser", "paths", "trade")),
        *((over, "--fovea raw") for over in ("denoiser", "paths", "trade")),
        *(("band", option) for option in ("--fov-a 30", "--fov-b 10")),
        ("acuity", "--acuity-model none"),
        *((over, "--reference-spp 64") for over in ("resolution", "aspect", "radius", "spp", "view")),
    ],
)
def test_an_option_that_would_change_nothing_is_refused(over, option, monkeypatch, capsys):
    """Also where its value is the default."""
    assert run(monkeypatch, "sweep", "cornell", "--over", over, *option.split()) == 2
    error = capsys.readouterr().err
    assert f"{option.split()[0]}: has no influence on a sweep --over {over}" in error
    assert error.count("\n") == 1


def test_what_applied_is_written_down_and_nothing_else(written):
    found = written(
        "radius", "--spp", 2, "--acuity-model", "none", "--display", "hmd", "--fov-a", 10, "--fov-b", 5
    )
    assert found.keys() - CONTENT == {
        "fovea",
        "fov_b_of_fov_a",
        "spp",
        "acuity_model",
        "integrator",
        "display",
    }
    assert (found["spp"], found["acuity_model"], found["fov_b_of_fov_a"]) == (2, "none", 0.5)
    assert found["display"]["fov"] == 97.0
    assert len(found["forest"]) >= 16
    assert (found["scene"], found["over"]) == ("cornell", "radius")


def test_targets_are_stored_for_later(written, monkeypatch, tmp_path):
    """What `hybrid render --target-ms` chooses from has the times and the quality of the sweep's rows."""
    monkeypatch.setattr(catalogue, "_TRADE_OUTER", (20.0,))
    monkeypatch.setattr(catalogue, "_TRADE_SPP", (1, 2))
    found = written("trade", "--size", 48, 40, "--reference-spp", 4)
    (file,) = home().glob("*/measured-trade-48x40-*.json")
    stored = json.loads(file.read_text())
    assert stored["metric"] == "jod"
    assert [row["milliseconds"] for row in stored["rows"]] == [row["ms"]["p50"] for row in found["rows"]]
    expected = [row["quality"]["whole jod"] for row in found["rows"]]
    assert [row["quality"] for row in stored["rows"]] == expected
    ranges = [row["quality_range"]["whole jod"] for row in found["rows"]]
    assert [row["spread"] for row in stored["rows"]] == ranges
    assert all(low < row["quality"] < high for row, (low, high) in zip(stored["rows"], ranges, strict=True))
    assert [(row["spp"], row["fovea"]) for row in stored["rows"]] == [
        (row["spp"], row["fovea"]) for row in found["rows"]
    ]


@extreme(
    "what a sweep is judged on",
    given="a scene whose own camera training has always seen",
    expected="three views that nothing was fitted to, means with their ranges, in times as well",
)
def test_rows_are_timed_and_judged_in_views_that_training_has_not_seen(corner, rough, base, monkeypatch, got):
    monkeypatch.setattr(catalogue, "_BAND_OUTER", (40.0,))
    judged, timed = [], set()
    make, render = module.reference, HybridMethod.render

    def recorded(tracer, camera, *rest):
        judged.append(camera)
        return make(tracer, camera, *rest)

    def seen(self, view, *rest):
        timed.add(min(range(3), key=lambda n: np.abs(view.camera.position - unseen[n].camera.position).max()))
        assert np.abs(view.camera.position - corner.camera.position).max() > 1e-3
        return render(self, view, *rest)

    unseen = unseen_views(corner, 3, base.camera.width, base.camera.height)
    monkeypatch.setattr(module, "reference", recorded)
    monkeypatch.setattr(HybridMethod, "render", seen)
    content = sweep(
        corner, rough, "band", base, SweepEffort(3, 1, 4), lambda _: None, lambda done, total: None
    )
    assert [camera.key for camera in judged] == [camera.key for camera in unseen]
    assert timed == {0, 1, 2}
    assert got(content["views"]) == 3
    for row in content["rows"]:
        low, high = row["quality_range"]["whole psnr"]
        assert low < row["quality"]["whole psnr"] < high
        assert row["ms_range"][0] <= row["ms"]["p50"] <= row["ms_range"][1]
        assert row["ratio_range"][0] <= row["ratio_range"][1]


def test_the_result_is_written_before_what_it_resumes_from_is_deleted(
    corner, rough, base, tmp_path, monkeypatch
):
    """An interruption in between loses nothing."""
    monkeypatch.setattr(catalogue, "_BAND_OUTER", (40.0,))
    kept = []

    def write(content: dict) -> None:
        kept.append(list(home().glob("*/sweep-band-*.json")))
        assert len(content["rows"]) == 4

    content = sweep(corner, rough, "band", base, SweepEffort(3, 1, 4), write, lambda done, total: None)
    assert len(kept[0]) == 1
    assert not kept[0][0].exists()
    assert (content["over"], content["break_even"]) == ("band", [])


def identity(corner, rough, base, over: str = "band", effort: SweepEffort = EFFORT) -> str:
    sweep = sweep_named(over, rough.counts)
    found = identity_of(corner, rough, sweep, sweep.settings(base, [View(base.camera)]), effort)
    return short_hash(json.loads(json.dumps(found)))


def test_rows_depend_on_everything_that_they_are_measured_with(corner, rough, base):
    known = identity(corner, rough, base)
    assert identity(corner, rough, base) == known
    others = [
        identity(corner, white_dot((0, 0, 1)), base),
        identity(corner, rough, base, "denoiser"),
        identity(corner, rough, replace(base, camera=base.camera.resized(60, 40))),
        identity(corner, rough, replace(base, frame=replace(base.frame, spp=3))),
        identity(corner, rough, base, effort=SweepEffort(4, 1, 4)),
        identity(corner, rough, base, effort=SweepEffort(3, 2, 4)),
        identity(corner, rough, base, effort=SweepEffort(3, 1, 5)),
    ]
    assert len({known, *others}) == 1 + len(others)


def test_metrics_that_are_installed_later_are_measured_anew(corner, rough, base, monkeypatch):
    with_quality, without = (identity(corner, rough, base, over) for over in ("band", "radius"))
    monkeypatch.setattr(module, "missing", lambda: ["nothing is installed"])
    assert identity(corner, rough, base, "band") != with_quality
    assert identity(corner, rough, base, "radius") == without


@pytest.mark.parametrize("over", [*SWEEPS, "layers"])
def test_what_applied_to_all_rows_is_written_down_and_nothing_else(base, over):
    sweep = sweep_named(over, (1, 2))
    found = settings_of_row(sweep, base, EFFORT)
    assert found.pop("display") == asdict(base.frame.display)
    rows = [json.loads(json.dumps(one.frame.as_json())) for one in sweep.settings(base, [View(base.camera)])]
    for name in ("fovea", "fov_a", "fov_b", "spp", "acuity_model"):
        same = all(row[name] == rows[0][name] for row in rows)
        assert (name in found) == same, name
        assert found.get(name, rows[0][name]) == rows[0][name]
    assert ("width" in found) == ("size" not in sweep.sets)
    assert found.get("reference_spp") == (4 if sweep.with_quality else None)
    ratio = base.frame.fov_b / base.frame.fov_a
    assert found.get("fov_b_of_fov_a") == (ratio if sweep.scales_radii else None)


def test_regions_are_around_the_centre_whatever_the_gaze(base):
    elsewhere = replace(base, frame=replace(base.frame, gaze=Gaze(0.1, 0.1)))
    regions, others = regions_of(base), regions_of(elsewhere)
    assert list(regions) == ["whole", "foveal", "peripheral"]
    np.testing.assert_array_equal(regions["foveal"].mask, others["foveal"].mask)
    assert regions["foveal"].mask[16, 24]


def test_an_empty_seam_is_no_reason_to_refuse_and_an_empty_fovea_is(base):
    narrow = replace(base, frame=replace(base.frame, fov_a=25.0, fov_b=24.99))
    assert "foveal" in regions_of(narrow)
    tiny = replace(base, frame=replace(base.frame, fov_a=0.1, fov_b=0.05))
    with pytest.raises(UserError, match="the foveal region of this frame is empty"):
        regions_of(tiny)


def test_metrics_are_named_by_region(base, renderer):
    method = HybridMethod(renderer, base.frame)
    image = method.render(View(base.camera), Gaze(), 0).image
    truth = Reference(image + 0.05, (image, image), np.zeros(image.shape[:2], np.float32))
    found, ranges = quality_of(base, method, [truth])
    assert {"whole psnr", "foveal psnr", "peripheral psnr", "whole ssim"} <= set(found)
    assert found["whole psnr"] == pytest.approx(psnr(image, truth.radiance))
    assert ranges["whole psnr"] == (found["whole psnr"], found["whole psnr"])
    mask = regions_of(base)["peripheral"].mask
    assert found["peripheral psnr"] == pytest.approx(psnr(image, truth.radiance, mask))
