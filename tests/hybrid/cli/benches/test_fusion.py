"""`hybrid bench fusion`."""

from __future__ import annotations

import pytest

from hybrid.cli.benches.fusion import fusion as command

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_there_is_a_row_per_scale_count_and_method(bench_fovea, capsys):
    rows = bench_fovea(command.__name__, "--spp", 1, "--spp", 4, "--seeds", 1)
    methods = ["splat", "raw", "denoised", "denoised, path", "mean", "statistical", "fused, even", "fused"]
    keys = [(row["scale"], row["spp"], row["method"]) for row in rows]
    assert keys == [(scale, spp, method) for scale in (1, 2) for spp in (1, 4) for method in methods]
    by_key = dict(zip(keys, rows, strict=True))
    assert by_key[1, 1, "splat"]["psnr"] == by_key[1, 4, "splat"]["psnr"]
    assert by_key[1, 4, "raw"]["psnr"] > by_key[1, 1, "raw"]["psnr"]
    # Few samples go everywhere.
    assert by_key[2, 1, "fused"]["psnr"] == by_key[2, 1, "fused, even"]["psnr"]
    assert all(row["views"] == 1 and row["reference_psnr"] > 10 for row in rows)
    shown = capsys.readouterr().out.splitlines()
    assert shown[1].split()[:3] == ["1x", "1", "splat"]
    assert len(shown) == 1 + len(rows)
