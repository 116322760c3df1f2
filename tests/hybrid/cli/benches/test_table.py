"""Cells that several benches print."""

from __future__ import annotations

from hybrid.cli.benches.table import metrics


def test_metrics_stand_below_each_other():
    row = {"psnr": 9.876, "ssim": 0.98765}
    assert metrics(row | {"flip": 0.12345, "jod": 9.876}) == "  9.88  0.9877  0.1235   9.88"
    assert metrics(row) == "  9.88  0.9877       -      -"
