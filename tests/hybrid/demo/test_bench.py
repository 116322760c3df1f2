"""The window measured: how well a target was kept, with a load in the middle and without."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest


def test_frames_within_a_fifth_of_the_target_keep_it():
    pytest.importorskip("PySide6.QtWidgets", reason="the window needs Qt", exc_type=ImportError)
    from hybrid.demo.bench import steadiness

    # Ten frames a second: two of eight are late before the load, all under it, one of two right after.
    frames = [(0.1 * i, 100.0 if i % 4 else 130.0) for i in range(8)]
    frames += [(1.0, 150.0), (1.2, 170.0), (1.4, 160.0), (2.0, 119.0), (3.0, 121.0), (4.0, 100.0)]
    found = steadiness(frames, 10.0, (0.9, 1.5))
    assert found["kept"] == pytest.approx(7 / 9)
    assert found["kept_after_load"] == pytest.approx(1 / 2)
    assert found["ms_under_load"] == 160
    alone = steadiness(frames, 10.0, None)
    assert alone["kept"] == pytest.approx(8 / 14)
    assert "kept_after_load" not in alone
    assert "ms_under_load" not in alone


def test_a_load_in_the_middle_is_measured(made, offscreen, tmp_path):
    out = tmp_path / "bench.json"
    command = [sys.executable, "-m", "hybrid.cli.main", "demo", "cornell", "--forest", made / "box.forest"]
    command += ["--size", 96, 64, "--target", 10, "--bench", 5, "--load", 1, "--json", out]
    ended = subprocess.run(
        [str(part) for part in command],
        env=offscreen | {"HYBRID_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads(out.read_text())
    begin, end = found["target"]["loaded_s"]
    assert begin == pytest.approx(2, abs=0.5)
    assert end - begin == pytest.approx(1, abs=0.5)
    assert found["target"]["ms_under_load"] > 0
    assert "of frames within 20% of 100 ms" in ended.stdout
