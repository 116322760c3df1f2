"""`hybrid bench seam`."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hybrid.cli.benches.seam import seam as command

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_there_is_a_row_per_mode(bench_fovea, tmp_path, capsys):
    display = tmp_path / "d.json"
    display.write_text(json.dumps({"width": 64, "height": 64, "fov": 40}))
    rows = bench_fovea(command.__name__, "--display", display)
    assert [row["mode"] for row in rows] == ["raw", "denoised", "fused"]
    assert all(np.isfinite(row["difference"]) and row["sectors"] >= 0 for row in rows)
    shown = capsys.readouterr().out.splitlines()
    assert "inner against outer side" in shown[0]
    assert shown[1].split()[:2] == ["raw", f"{rows[0]['difference']:+.2%}"]
