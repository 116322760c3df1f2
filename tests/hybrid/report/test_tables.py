"""Tables of the page."""

from __future__ import annotations

from hybrid.evaluation.results import keys_of
from hybrid.report.tables import quality_table, sweep_columns, time_table
from tests.hybrid.report import content


def test_quality_has_a_row_per_method_and_one_for_the_references():
    found = content.evaluation()
    table = quality_table(found, "foveal", keys_of(found))
    assert (table["region"], table["metrics"]) == ("foveal", ["flip", "jod"])
    cells = {(row["method"], row["budget"]): row["cells"] for row in table["rows"]}
    assert cells["hybrid, fused", "fixed"] == ["0.1000", "9.00"]
    assert cells["rmfr, tuned", "equal-time"] == ["0.2000", "8.00"]
    assert cells["reference, half against half", "fixed"] == ["-", "9.50"]
    assert {row["method"] for row in table["rows"] if row["ours"]} == {
        "hybrid, fused",
        "hybrid, fused, 16 spp",
    }


def test_times_have_percentiles_frame_rates_and_passes():
    found = content.evaluation()
    del found["time"][0]["ms"]["p95"]
    found["time"][1]["passes"]["denoise"] = 3.4
    table = time_table(found)
    assert table["columns"] == ["p50", "p95", "p99", "FPS", "frames", "trace", "denoise"]
    assert table["rows"][0]["cells"] == ["10", "-", "-", "100.0", "20", "7", "-"]
    assert table["rows"][1]["cells"] == ["40", "80", "-", "25.0", "20", "28", "3"]


def test_a_sweeps_columns_end_with_its_quality():
    columns = sweep_columns(content.sweep()["rows"])
    assert list(columns)[-3:] == ["whole jod", "foveal jod", "foveal flip"]
    assert columns["whole jod"] == ["8.12", "8.12"]
    assert columns["foveal flip"] == ["0.1000", "0.1000"]
    assert columns["radius"] == ["20", "90"]
