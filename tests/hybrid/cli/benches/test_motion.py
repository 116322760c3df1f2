"""`hybrid bench motion`."""

from __future__ import annotations

import pytest

from hybrid.cli.benches.motion import motion as command

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_a_walk_is_compared_with_single_frames(bench_fovea, capsys):
    rows = bench_fovea(command.__name__)
    found = {(row["mode"], row["method"]): row["psnr"] for row in rows}
    assert len(found) == 9
    assert found["raw", "16 frames of 1 spp"] > found["raw", "single frame, 1 spp"] + 3
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 1 + len(rows)
    for line, row in zip(shown[1:], rows, strict=True):
        assert line.split()[0] == row["mode"]
        assert line.endswith(" dB") == ("fresh_psnr" in row)
