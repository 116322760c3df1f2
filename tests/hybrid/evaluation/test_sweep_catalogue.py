"""What sweeps vary, and their rows as tables and sentences."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import pytest

from compose.base.errors import UserError
from compose.camera.camera import View
from compose.eye.acuity import ACUITY_MODELS
from compose.fovea.foveation import FoveaMode
from hybrid.evaluation.sweep_catalogue import (
    FPC_BREAK_EVEN,
    FPC_FIGURE_14,
    FPC_FIGURE_14_FULL,
    FPC_FIGURE_14_RADII,
    FPC_TABLE_4,
    FPC_TABLE_5,
    FPC_VIEW_SIZES,
    SWEEPS,
    Setting,
    break_even,
    sentence,
    sweep_named,
    table,
    varied,
)
from hybrid.measure.frame_times import jittered_view, ratio_interval
from tests import small


@pytest.mark.parametrize("mode", list(FoveaMode))
def test_all_but_raw_foveas_are_denoised(base, mode):
    setting = replace(base, frame=replace(base.frame, fovea=mode))
    assert setting.is_denoised == (mode is not FoveaMode.RAW)


def test_what_comes_before_the_times_was_varied():
    row = {"width": 4, "radius": 20, "ms": {"p50": 3.0}, "ratio": 2.0}
    assert varied(row) == {"width": 4, "radius": 20}
    assert varied({"ms": {}, "ratio": 2.0}) == {}


COUNTS = (5, 20, 80)
ALL = (*SWEEPS, "layers")


def rows_of(name: str, base: Setting) -> list[Setting]:
    views = [jittered_view(View(base.camera), number) for number in range(3)]
    return sweep_named(name, COUNTS).settings(base, views)


def size(setting: Setting) -> tuple[int, int]:
    return setting.camera.width, setting.camera.height


@pytest.mark.parametrize(("name", "table"), [("resolution", FPC_TABLE_4), ("aspect", FPC_TABLE_5)])
def test_sizes_are_those_of_fpcs_tables(base, name, table):
    rows = rows_of(name, base)
    assert [size(row) for row in rows] == list(table)
    assert [row.varied for row in rows] == [{"width": w, "height": h} for w, h in table]
    assert [row.paper["ratio"] for row in rows] == [ours / full for ours, full in table.values()]
    assert {row.frame for row in rows} == {base.frame}


def test_radii_are_swept_at_each_size_with_the_band_in_proportion(base):
    rows = rows_of("radius", base)
    expected = list(product(FPC_BREAK_EVEN, range(10, 100, 10)))
    assert [(size(row), row.varied["radius"]) for row in rows] == expected
    for row in rows:
        assert row.frame.fov_a == row.varied["radius"]
        assert row.frame.fov_b == pytest.approx(row.frame.fov_a * base.frame.fov_b / base.frame.fov_a)
        assert (row.varied["width"], row.varied["height"]) == size(row)


def test_samples_are_swept_against_full_frames_of_one_sample_as_well(base):
    rows = rows_of("spp", base)
    assert [(row.frame.spp, row.frame.fov_a) for row in rows] == list(product((1, 2, 4, 6), (10, 20, 50, 90)))
    assert {size(row) for row in rows} == {(1012, 1061)}
    for row in rows:
        assert row.over_one_spp
        assert row.varied == {"spp": row.frame.spp, "radius": row.frame.fov_a}
    # FPC has figures at radii of 10 and 90 %: 200, 100, 192 and 67 frames per second over 150.
    papers = [row.paper.get("ratio_1spp") for row in rows[:8]]
    assert papers == [200 / 150, None, None, 100 / 150, 192 / 150, None, None, 67 / 150]


def test_views_are_those_of_the_scene_at_fpcs_sizes(base):
    rows = rows_of("view", base)
    keys = [(row.varied["width"], row.varied["view"], row.varied["radius"]) for row in rows]
    assert keys == list(product((1280, 3316), (0, 1, 2), (20, 50)))
    assert len({row.camera.key for row in rows}) == 2 * 3
    assert [row.frame.fov_a for row in rows[:2]] == [20, 50]


def test_bands_have_four_widths_at_four_radii(base):
    rows = rows_of("band", base)
    expected = [(a, a * share) for a in (10, 20, 30, 40) for share in (0.25, 0.5, 0.75, 1)]
    assert [(row.frame.fov_a, row.frame.fov_b) for row in rows] == expected
    assert [(row.varied["fov_a"], row.varied["fov_b"]) for row in rows] == expected


def test_all_acuity_models_and_all_foveas_have_their_row(base):
    assert [row.frame.acuity_model for row in rows_of("acuity", base)] == list(ACUITY_MODELS)
    rows = rows_of("denoiser", base)
    assert [(row.frame.spp, row.frame.fovea) for row in rows] == list(product((1, 2, 4, 16), FoveaMode))
    assert rows[1].varied == {"fovea": "denoised", "spp": 1}


def test_targets_choose_from_radii_samples_and_foveas(base):
    rows = rows_of("trade", base)
    made = {(row.frame.fov_a, row.frame.spp, row.frame.fovea) for row in rows}
    assert made == set(product((5, 10, 20, 30), (1, 2, 4, 8), (FoveaMode.DENOISED, FoveaMode.FUSED)))
    assert len(rows) == 32
    for row in rows:
        frame = row.frame
        assert row.varied == {
            "fovea": frame.fovea.value,
            "spp": frame.spp,
            "fov_a": frame.fov_a,
            "fov_b": frame.fov_b,
        }


def test_layers_are_left_out_at_either_end(base):
    rows = rows_of("layers", base)
    assert [row.frame.layers for row in rows] == [(1, 1), (1, 2), (1, 3), (2, 3), (3, 3)]
    assert [row.varied["gaussians"] for row in rows] == [5, 20, 80, 80, 80]
    assert [row.varied["layers"] for row in rows][3] == "2 to 3"


@pytest.mark.parametrize("name", ALL)
def test_no_two_rows_of_a_sweep_are_varied_alike(base, name):
    rows = rows_of(name, base)
    assert len({str(row.varied) for row in rows}) == len(rows) > 1
    assert len({tuple(row.varied) for row in rows}) == 1


# Other values of what a command may set, and what they change of a base.
OTHERS: dict[str, dict[str, Any]] = {
    "fovea": {"fovea": FoveaMode.DENOISED},
    "fov_b": {"fov_b": 10.0},
    "fov_a": {"fov_a": 25.0},
    "spp": {"spp": 3},
    "acuity_model": {"acuity_model": "stelacsf"},
}


@pytest.mark.parametrize(("name", "quantity"), list(product(ALL, OTHERS)))
def test_a_quantity_is_ignored_where_it_changes_no_row_and_nowhere_else(base, name, quantity):
    other = replace(base, frame=replace(base.frame, **OTHERS[quantity]))
    changed = rows_of(name, base) != rows_of(name, other)
    assert changed == (quantity not in sweep_named(name, COUNTS).ignored)


@pytest.mark.parametrize("name", ALL)
def test_a_size_is_ignored_where_the_sweep_sets_it(base, name):
    other = replace(base, camera=base.camera.resized(60, 40))
    sizes, others = ([size(row) for row in rows_of(name, one)] for one in (base, other))
    assert (sizes != others) == ("size" not in sweep_named(name, COUNTS).ignored)


@pytest.mark.parametrize("name", ALL)
def test_references_are_needed_for_quality_only(name):
    sweep = sweep_named(name, COUNTS)
    assert sweep.with_quality == ("reference_spp" not in sweep.ignored)
    assert sweep.with_quality == (name in ("band", "acuity", "trade", "denoiser", "paths", "layers"))


def test_a_sweep_that_does_not_exist_is_named():
    with pytest.raises(UserError, match=r"sweep over moon: must be over resolution, aspect.* or layers"):
        sweep_named("moon", (1,))


def test_speed_ups_are_those_of_the_papers_text():
    """Table 4: 800x600 is 19.62 % slower, 3316x1061 is 43.31 % faster."""
    speed_ups = [ours / full - 1 for ours, full in FPC_TABLE_4.values()]
    assert speed_ups == pytest.approx([-0.1962, 0.2828, 0.3771, 0.4331], abs=0.002)
    speed_ups = [ours / full - 1 for ours, full in FPC_TABLE_5.values()]
    assert speed_ups == pytest.approx([-0.0185, 0.0667, 0.17, 0.2842], abs=0.002)


def test_tables_agree_where_they_show_the_same_size():
    assert FPC_TABLE_4[1012, 1061] == FPC_TABLE_5[1012, 1061]
    for width, height in FPC_TABLE_5:
        assert width / height == pytest.approx(1012 / 1061, abs=0.001)


def test_figures_that_sweeps_repeat_are_known():
    assert set(FPC_VIEW_SIZES) <= set(FPC_BREAK_EVEN)
    for by_radius in FPC_FIGURE_14.values():
        assert set(by_radius) <= set(FPC_FIGURE_14_RADII)
        assert by_radius[10] > by_radius[90]
    assert FPC_FIGURE_14[1][10] / FPC_FIGURE_14_FULL == pytest.approx(4 / 3)


ROW = {
    "spp": 1,
    "radius": 12.5,
    "ms": {"p50": 41.6, "p95": 60.0},
    "full_ms": {"p50": 103.4, "p95": 110.0},
    "ratio": 2.4856,
    "covered": 0.08449,
    "quality": {"whole ssim": 0.9},
}


def test_cells_are_rounded_and_columns_are_in_order():
    assert table([ROW]) == {
        "spp": ["1"],
        "radius": ["12.5"],
        "covered, %": ["8.4"],
        "ms": ["42"],
        "full, ms": ["103"],
        "ratio": ["2.49"],
    }


def test_fpcs_ratios_stand_beside_ours():
    rows = [{**ROW, "ratio_1spp": 1.25, "paper": {"ratio_1spp": 200 / 150}}, {**ROW, "ratio_1spp": 0.5}]
    columns = table(rows)
    assert list(columns)[-3:] == ["ratio", "ratio to 1 spp", "FPC's ratio to 1 spp"]
    assert columns["ratio to 1 spp"] == ["1.25", "0.50"]
    # Where FPC has no figure there is none.
    assert columns["FPC's ratio to 1 spp"] == ["1.33", "-"]
    assert table([{**ROW, "paper": {"ratio": 1.2828}}])["FPC's ratio"] == ["1.28"]


def test_rows_without_coverage_have_no_such_column():
    assert "covered, %" not in table([{name: value for name, value in ROW.items() if name != "covered"}])


def only(*ratios: float) -> dict:
    """The row of one size, at radii of 10, 50 and 90 %, of ratios that are known to within 0.1."""
    rows = [
        {"width": 4, "height": 3, "radius": r, "ratio": ratio, "ratio_interval": (ratio - 0.1, ratio + 0.1)}
        for r, ratio in zip((10, 50, 90), ratios, strict=True)
    ]
    (row,) = break_even(rows)
    return row


def test_the_radius_is_interpolated_where_the_ratio_falls_below_1():
    """From 1.5 at 50 % to 0.5 at 90 %: 1 at 70 %; its upper bound, from 1.6 to 0.6, at 74 %."""
    assert only(5.0, 1.5, 0.5)["radius"] == pytest.approx(70)
    assert only(5.0, 1.5, 0.5)["slower_from"] == pytest.approx(74)
    assert only(3.0, 0.5, 0.4)["radius"] == pytest.approx(42)
    # A ratio of exactly 1 is not slower yet.
    assert only(2.0, 1.0, 0.5)["radius"] == pytest.approx(50)


def test_it_may_be_at_no_radius_or_at_the_smallest():
    assert only(5.0, 1.5, 1.1)["radius"] is None
    assert only(5.0, 1.5, 0.95)["slower_from"] is None
    assert only(0.9, 0.8, 0.7)["radius"] == 10
    assert only(1.0, 1.0, 1.0)["radius"] is None


def test_the_first_crossing_counts():
    assert only(0.5, 2.0, 0.5)["radius"] == 10
    rows = [
        {"width": 4, "height": 3, "radius": r, "ratio": ratio, "ratio_interval": (ratio, ratio)}
        for r, ratio in ((10, 2.0), (20, 0.5), (30, 1.5), (40, 0.5))
    ]
    assert break_even(rows)[0]["radius"] == pytest.approx(10 + 20 / 3)


def test_the_lowest_ratio_is_that_of_any_radius():
    assert only(5.0, 0.5, 0.7)["least_ratio"] == 0.5


def test_sizes_stand_apart_beside_fpcs_figure():
    rows = [
        {"width": w, "height": 780, "radius": r, "ratio": w / 1280 / r, "ratio_interval": (0, 0)}
        for w in (1280, 64)
        for r in (0.5, 2.0)
    ]
    first, second = break_even(rows)
    assert (first["width"], first["height"], first["paper"]) == (1280, 780, 51.0)
    assert (second["width"], second["paper"]) == (64, None)
    assert first["radius"] == pytest.approx(0.5 + 1.5 * (2 - 1) / (2 - 0.5))
    assert second["radius"] == 0.5


def test_a_sentence_says_all_of_it():
    assert sentence({**only(5.0, 1.5, 0.95), "paper": 51.0}) == (
        "4x3: as fast as full path tracing at a radius of 86 % of the height (FPC: 51), slower with 95 % "
        "confidence at no radius; lowest ratio 0.950."
    )
    assert "radius of more than 90 % of the height" in sentence({**only(5.0, 1.5, 1.1), "paper": 51.0})
    assert "confidence from 74 % on; lowest ratio 0.500." in sentence({**only(5.0, 1.5, 0.5), "paper": 51.0})


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
    assert 180 < held[64] < 200
    assert held[8] > 170
    assert widths[64] < widths[8] / 2


def test_drift_that_both_share_does_not_widen_an_interval():
    """Pairs are drawn together: a machine that gets slower makes both slower."""
    drift = [1 + 0.1 * n for n in range(20)]
    low, high = ratio_interval([150 * d for d in drift], [100 * d for d in drift])
    assert (low, high) == pytest.approx((1.5, 1.5))


def test_an_interval_repeats():
    times = list(small.rng().uniform(80, 120, 9))
    assert ratio_interval(times, times[::-1]) == ratio_interval(times, times[::-1])
