"""Sweeps from their name to their table, as `hybrid sweep` runs them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hybrid.base.cache_folder import home
from hybrid.evaluation import methods as path_traced
from hybrid.evaluation import sweep_catalogue as catalogue
from hybrid.evaluation import sweep_run as run_module
from hybrid.evaluation.methods import HybridMethod
from hybrid.evaluation.sweep_catalogue import FPC_FIGURE_14, SweepEffort
from hybrid.evaluation.sweep_run import sweep
from hybrid.render import periphery as saliency
from pathtrace.region.neighbourhood import unseen_views
from tests.extremes import extreme
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home", "quick_metrics")
# What a sweep's file has beside the settings that its rows have in common.
CONTENT = {"scene", "forest", "over", "title", "views", "rows", "break_even", "machine"}


@pytest.fixture
def swept(made, monkeypatch, tmp_path):
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


def test_radius_has_a_row_per_size_and_radius_and_tells_where_it_breaks_even(swept, capsys):
    found = swept("radius")
    keys = [(row["width"], row["height"], row["radius"]) for row in found["rows"]]
    assert keys == [(w, 32, r) for w in (48, 64) for r in (20, 90)]
    for row in found["rows"]:
        check(row)
    assert [(row["width"], row["paper"]) for row in found["break_even"]] == [(48, 51.0), (64, 50.0)]
    assert [row["covered"] for row in found["rows"]] == pytest.approx([0.084, 0.99, 0.063, 0.93], rel=0.1)
    shown = capsys.readouterr().out.splitlines()
    assert "covered, %" in shown[1]
    assert f"{100 * found['rows'][0]['covered']:.1f}" in shown[2].split()


def test_every_timed_frame_pays_for_what_its_camera_shows(swept, monkeypatch):
    """Rows share renderers, which keep what depends on the camera alone: saliency, for one."""
    features, cameras = [], set()
    look, trace = saliency.saliency, path_traced.traced_image

    def counted(image):
        features.append(image.shape)
        return look(image)

    def traced(tracer, camera, *rest):
        cameras.add(camera.key)
        return trace(tracer, camera, *rest)

    monkeypatch.setattr(saliency, "saliency", counted)
    monkeypatch.setattr(path_traced, "traced_image", traced)
    rows = swept("radius")["rows"]
    assert len(features) == len(rows) * (3 + 1)
    assert len(cameras) == 2 * (3 + 1)


@pytest.mark.parametrize("fovea", ["raw", "denoised"])
def test_samples_are_compared_with_one_sample_as_well(swept, capsys, fovea):
    """As in Foveated Path Culling's Figure 14: its frame rate over that of its path tracing at 1 sample."""
    found = swept("spp", "--fovea", fovea)["rows"]
    assert [(row["spp"], row["radius"]) for row in found] == [(n, r) for n in (1, 2) for r in (10, 90)]
    one = found[0]["full_ms"]["p50"]
    for row in found:
        check(row)
        assert row["ratio_1spp"] == pytest.approx(one / row["ms"]["p50"])
    assert [row["paper"] for row in found] == [{"ratio_1spp": fps / 150} for fps in (200, 100, 192, 67)]
    shown = capsys.readouterr().out
    assert "ratio to 1 spp  FPC's ratio to 1 spp" in shown.splitlines()[1]
    assert [line.split()[-1] for line in shown.splitlines()[2:6]] == ["1.33", "0.67", "1.28", "0.45"]


def test_sweeps_with_quality_have_it_in_each_row(swept):
    found = swept("band", "--size", 48, 40, "--reference-spp", 4, "--fovea", "fused")
    assert [row["fov_b"] for row in found["rows"]] == [10, 20, 30, 40]
    for row in found["rows"]:
        check(row)
        assert 0 < row["quality"]["foveal ssim"] <= 1
        assert row["quality"]["peripheral psnr"] > 5


def test_views_are_other_ones_than_the_scenes(swept):
    assert len({row["view"] for row in swept("view")["rows"]}) == 4


def test_layers_have_their_gaussians(swept):
    layers = swept("layers", "--size", 48, 40, "--reference-spp", 4)["rows"]
    assert [row["layers"] for row in layers] == ["1 to 1", "1 to 2", "2 to 2"]
    assert layers[0]["gaussians"] < layers[1]["gaussians"]


def test_an_interrupted_sweep_resumes(swept, monkeypatch, tmp_path):
    """Sizes that were measured are kept, others and those of other settings are measured."""
    timed, times = run_module.interleaved_passes, []

    def interrupted(*arguments):
        if len(times) == 1:
            raise KeyboardInterrupt
        times.append(timed(*arguments))
        return times[-1]

    monkeypatch.setattr(run_module, "interleaved_passes", interrupted)
    with pytest.raises(AssertionError, match="130"):
        swept("radius")
    (kept,) = home().glob("*/sweep-radius-*.json")
    first = json.loads(kept.read_text())["results"]["0"]

    def counted(*arguments):
        times.append(timed(*arguments))
        return times[-1]

    monkeypatch.setattr(run_module, "interleaved_passes", counted)
    swept("radius", "--spp", 2)
    assert len(times) == 3
    assert kept.exists()
    rows = swept("radius")["rows"]
    assert len(times) == 4
    assert rows[:2] == first
    assert [(row["width"], row["radius"]) for row in rows] == [(w, r) for w in (48, 64) for r in (20, 90)]
    assert not list(home().glob("*/sweep-*"))


def test_a_seam_whose_quality_is_not_measured_may_be_empty(swept):
    size = ["--size", 48, 40, "--reference-spp", 4]
    rows = swept("acuity", *size, "--fov-a", 25, "--fov-b", 24.99)["rows"]
    assert all("foveal ssim" in row["quality"] for row in rows)


def test_an_empty_fovea_is_refused_before_anything_is_timed(made, monkeypatch, capsys):
    def forbidden(*_):
        raise AssertionError("timed")

    monkeypatch.setattr(run_module, "interleaved_passes", forbidden)
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


def test_what_applied_is_written_down_and_nothing_else(swept):
    found = swept(
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


def test_targets_are_stored_for_later(swept, monkeypatch, tmp_path):
    """What `hybrid render --target-ms` chooses from has the times and the quality of the sweep's rows."""
    monkeypatch.setattr(catalogue, "_TRADE_OUTER", (20.0,))
    monkeypatch.setattr(catalogue, "_TRADE_SPP", (1, 2))
    found = swept("trade", "--size", 48, 40, "--reference-spp", 4)
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
    make, render = run_module.reference, HybridMethod.render

    def recorded(tracer, camera, *rest):
        judged.append(camera)
        return make(tracer, camera, *rest)

    def seen(self, view, *rest):
        timed.add(min(range(3), key=lambda n: np.abs(view.camera.position - unseen[n].camera.position).max()))
        assert np.abs(view.camera.position - corner.camera.position).max() > 1e-3
        return render(self, view, *rest)

    unseen = unseen_views(corner, 3, base.camera.width, base.camera.height)
    monkeypatch.setattr(run_module, "reference", recorded)
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
