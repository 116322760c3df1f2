"""Sweeps: their rows, where two ways of rendering break even, and FPC's figures beside them."""

from __future__ import annotations

import json

import pytest

from compose.base.errors import UserError
from hybrid.baselines import methods as peers
from hybrid.frame import periphery
from hybrid.sweeps import catalogue
from hybrid.sweeps import run as run_module
from hybrid.sweeps.break_even import break_even, ratio_interval, sentence
from hybrid.sweeps.catalogue import SWEEPS, sweep_named
from tests import small
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


@pytest.fixture
def swept(made, monkeypatch, tmp_path):
    """Runs a sweep over small frames and returns what it wrote."""
    monkeypatch.setattr(catalogue, "BREAK_EVEN", {(48, 32): 51.0, (64, 32): 50.0})
    monkeypatch.setattr(catalogue, "_RADII", (20, 90))
    monkeypatch.setattr(catalogue, "_VIEW_SIZES", ((48, 32),))
    monkeypatch.setattr(catalogue, "_BAND_OUTER", (40.0,))
    monkeypatch.setattr(catalogue, "_FIGURE_14_SIZE", (48, 32))
    monkeypatch.setattr(catalogue, "_FIGURE_14_RADII", (10, 90))
    for spp in (4, 6):
        monkeypatch.delitem(catalogue._FIGURE_14, spp)

    def sweep(over: str, *options: object) -> dict:
        out = tmp_path / f"{over}.json"
        common = ["sweep", "cornell", "--forest", made / "box.forest", "--repeats", 3, "--warm-up", 1]
        assert run(monkeypatch, *common, "--over", over, "--json", out, *options) == 0
        return json.loads(out.read_text())

    return sweep


def check(row: dict) -> None:
    assert row["ratio"] == pytest.approx(row["full_ms"]["p50"] / row["ms"]["p50"])
    assert {"plan", "splat", "trace", "fovea", "blend"} <= set(row["passes"])
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
    """Rows share renderers, which keep what depends on the camera alone: what draws attention, for one."""
    features, cameras = [], set()
    look, trace = periphery.saliency, peers.traced_image

    def counted(image):
        features.append(image.shape)
        return look(image)

    def traced(tracer, camera, *rest):
        cameras.add(camera.key)
        return trace(tracer, camera, *rest)

    monkeypatch.setattr(periphery, "saliency", counted)
    monkeypatch.setattr(peers, "traced_image", traced)
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


def test_judged_sweeps_have_quality(swept):
    found = swept("band", "--reference-spp", 4, "--fovea", "fused")
    assert [row["fov_b"] for row in found["rows"]] == [10, 20, 30, 40]
    for row in found["rows"]:
        check(row)
        assert 0 < row["quality"]["foveal ssim"] <= 1
        assert row["quality"]["peripheral psnr"] > 5


def test_views_and_layers(swept):
    assert len({row["view"] for row in swept("view")["rows"]}) == 4
    layers = swept("layers", "--reference-spp", 4)["rows"]
    assert [row["layers"] for row in layers] == ["1 to 1", "1 to 2", "2 to 2"]
    assert layers[0]["gaussians"] < layers[1]["gaussians"]


def test_papers_figures_stand_beside_ours():
    """Foveated Path Culling, Table 4: 800x600 is 19.62 % slower, 3316x1061 is 43.31 % faster."""
    speed_ups = [ours / full - 1 for ours, full in catalogue._TABLE_4.values()]
    assert speed_ups == pytest.approx([-0.1962, 0.2828, 0.3771, 0.4331], abs=0.002)
    speed_ups = [ours / full - 1 for ours, full in catalogue._TABLE_5.values()]
    assert speed_ups == pytest.approx([-0.0185, 0.0667, 0.17, 0.2842], abs=0.002)


def test_the_radius_at_which_two_ways_cost_the_same():
    def only(*ratios: float) -> dict:
        """Of rows that are known to within 0.1."""
        rows = [
            {
                "width": 4,
                "height": 3,
                "radius": r,
                "ratio": ratio,
                "ratio_interval": (ratio - 0.1, ratio + 0.1),
            }
            for r, ratio in zip((10, 50, 90), ratios, strict=True)
        ]
        return break_even(rows)[0]

    assert only(5.0, 1.5, 1.1)["radius"] is None
    assert only(5.0, 1.5, 0.5)["radius"] == pytest.approx(70)
    assert only(5.0, 1.5, 0.5)["slower_from"] == pytest.approx(74)
    assert only(5.0, 1.5, 0.95)["slower_from"] is None
    assert only(0.9, 0.8, 0.7)["radius"] == 10
    assert only(5.0, 1.5, 0.5)["least_ratio"] == 0.5
    said = sentence({**only(5.0, 1.5, 0.95), "paper": 51.0})
    assert "at a radius of 86 % of the height (FPC: 51), slower with 95 % confidence at none" in said


def test_an_interval_holds_the_ratio_and_shrinks_with_more_frames():
    """Frames of 100 and of 80 ms with noise of a tenth: in 95 of 100 runs the interval holds 1.25."""
    rng = small.rng()
    held, widths = {8: 0, 64: 0}, {8: 0.0, 64: 0.0}
    for frames in held:
        for _ in range(200):
            full, ours = (mean * rng.normal(1, 0.1, frames) for mean in (100, 80))
            low, high = ratio_interval(list(full), list(ours))
            held[frames] += low <= 1.25 <= high
            widths[frames] += (high - low) / 200
    assert held[64] > 180
    assert held[8] > 170
    assert widths[64] < widths[8] / 2


def test_a_sweep_that_is_interrupted_goes_on(swept, monkeypatch, tmp_path):
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
    (kept,) = (tmp_path / "home").glob("*/sweep-radius-*.json")
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
    assert not list((tmp_path / "home").glob("*/sweep-*"))


def test_a_seam_that_is_not_judged_may_be_empty_and_a_region_that_is_may_not(
    swept, made, monkeypatch, capsys
):
    size = ["--size", 48, 40, "--reference-spp", 4]
    rows = swept("acuity_model", *size, "--fov-a", 25, "--fov-b", 24.99)["rows"]
    assert all("foveal ssim" in row["quality"] for row in rows)

    def forbidden(*_):
        raise AssertionError("timed")

    monkeypatch.setattr(run_module, "interleaved_passes", forbidden)
    command = ["sweep", "cornell", "--forest", made / "box.forest", "--over", "acuity_model", *size]
    assert run(monkeypatch, *command, "--fov-a", 0.1, "--fov-b", 0.05) == 2
    assert "the foveal region of this frame is empty" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("over", "option"),
    [
        *((over, "--size 48 32") for over in ("resolution", "aspect", "radius", "spp", "view")),
        *((over, "--spp 2") for over in ("spp", "denoiser", "trade")),
        *((over, "--fovea raw") for over in ("denoiser", "trade")),
        *(("band", option) for option in ("--fov-a 30", "--fov-b 10")),
        ("acuity_model", "--acuity-model none"),
        *((over, "--reference-spp 64") for over in ("resolution", "aspect", "radius", "spp", "view")),
    ],
)
def test_an_option_that_would_change_nothing_is_refused(over, option, monkeypatch, capsys):
    """Also where its value is the default."""
    assert run(monkeypatch, "sweep", "cornell", "--over", over, *option.split()) == 2
    error = capsys.readouterr().err
    assert f"{option.split()[0]}: changes nothing in a sweep --over {over}" in error
    assert error.count("\n") == 1


def test_what_applied_is_written_down_and_nothing_else(swept):
    found = swept(
        "radius", "--spp", 2, "--acuity-model", "none", "--display", "hmd", "--fov-a", 10, "--fov-b", 5
    )
    applied = found.keys() - {"scene", "over", "title", "rows", "break_even", "machine"}
    assert applied == {"forest", "fovea", "fov_b_of_fov_a", "spp", "acuity_model", "display"}
    assert (found["spp"], found["acuity_model"], found["fov_b_of_fov_a"]) == (2, "none", 0.5)
    assert found["display"]["fov"] == 97.0
    assert len(found["forest"]) >= 16
    found = swept("acuity_model", "--size", 48, 40, "--reference-spp", 4)
    applied = found.keys() - {"scene", "over", "title", "rows", "break_even", "machine", "forest", "display"}
    assert applied == {"width", "height", "fovea", "fov_a", "fov_b", "spp", "reference_spp"}


def test_a_sweep_that_does_not_exist_is_named(monkeypatch, capsys):
    with pytest.raises(UserError, match="--over moon: must be resolution, aspect"):
        sweep_named("moon", (1,))
    assert run(monkeypatch, "sweep", "cornell", "--over", "moon") == 2
    assert "--over moon: must be" in capsys.readouterr().err
    assert "radius" in SWEEPS
