"""Rows of a sweep as a table."""

from __future__ import annotations

from hybrid.evaluation.sweep_catalogue import table

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
