"""Tables of the page."""

from __future__ import annotations

from hybrid.evaluation.evaluation_page import FORMS, quality_table, time_table
from hybrid.evaluation.results import Results
from hybrid.evaluation.sweep_catalogue import table
from tests.hybrid.evaluation import content


def test_quality_has_a_row_per_method_and_one_for_the_references():
    found = content.evaluation()
    shown = quality_table(Results(found), "foveal")
    assert (shown["region"], shown["metrics"]) == ("foveal", ["flip", "jod"])
    cells = {(row["method"], row["budget"]): row["cells"] for row in shown["rows"]}
    assert cells["hybrid, fused", "fixed"] == ["0.1000", "9.00"]
    assert cells["rmfr, tuned", "equal-time"] == ["0.2000", "8.00"]
    assert cells["reference, half against half", "fixed"] == ["-", "9.50"]
    assert {row["method"] for row in shown["rows"] if row["ours"]} == {
        "hybrid, fused",
        "hybrid, fused, 16 spp",
    }


def test_times_have_percentiles_frame_rates_and_passes():
    found = content.evaluation()
    del found["time"][0]["ms"]["p95"]
    found["time"][1]["passes"]["denoise"] = 3.4
    shown = time_table(Results(found))
    assert shown["columns"] == ["p50", "p95", "p99", "FPS", "frames", "trace", "denoise"]
    assert shown["rows"][0]["cells"] == ["10", "-", "-", "100.0", "20", "7", "-"]
    assert shown["rows"][1]["cells"] == ["40", "80", "-", "25.0", "20", "28", "3"]


def test_a_sweeps_columns_end_with_its_quality():
    columns = table(content.sweep()["rows"], FORMS)
    assert list(columns)[-3:] == ["whole jod", "foveal jod", "foveal flip"]
    assert columns["whole jod"] == ["8.12", "8.12"]
    assert columns["foveal flip"] == ["0.1000", "0.1000"]
    assert columns["radius"] == ["20", "90"]


def test_a_baseline_that_missed_equal_time_is_marked_in_both_tables():
    found = content.evaluation()
    for row in found["time"]:
        row["over_ours"] = row["ms"]["p50"] / 10
        if row["method"] == "rmfr, tuned":
            row["over_ours"], row["ms_range"] = 1.2, [9.0, 13.0]
    shown = time_table(Results(found))
    (row,) = (row for row in shown["rows"] if row["method"] == "rmfr, tuned")
    assert shown["columns"][:4] == ["p50", "p95", "p99", "/ ours"]
    assert row["budget"] == "equal-time, missed: 20 % slower"
    assert (row["cells"][0], row["cells"][3]) == ("10 (9–13)", "1.20")
    budgets = [row["budget"] for row in quality_table(Results(found), "foveal")["rows"]]
    assert "equal-time, missed: 20 % slower" in budgets
    assert "equal-time" not in budgets


def test_a_sweeps_cells_have_the_range_over_the_views():
    rows = content.sweep()["rows"]
    for row in rows:
        row |= {"ms_range": [9.4, 120.6], "ratio_range": [0.3, 2.0]}
        row["quality_range"] = {"whole jod": [8.0, 8.25]}
    columns = table(rows, FORMS)
    assert columns["ms"] == ["30 (9–121)", "100 (9–121)"]
    assert columns["ratio"][0] == "1.33 (0.30–2.00)"
    assert columns["whole jod"] == ["8.12 (8.00–8.25)"] * 2
    assert columns["foveal jod"] == ["9.00"] * 2
