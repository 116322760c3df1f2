"""`hybrid bench change`."""

from __future__ import annotations

import pytest

from hybrid.cli.benches.change import change as command

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_changes_are_traced_and_not_seen_in_the_splats(bench_fovea, capsys):
    rows = bench_fovea(command.__name__, "--spp", 4)
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 1 + len(rows)
    assert shown[1].startswith(rows[0]["change"])
    found = {(row["change"], row["method"]): row["psnr"] for row in rows}
    changes = {change for change, _ in found}
    assert changes == {"object moved", "texture swapped", "lamp dimmed"}
    unchanged = bench_fovea("fusion", "--spp", 4, "--scale", 1, "--seeds", 1)
    splat = next(row["psnr"] for row in unchanged if row["scale"] == 1 and row["method"] == "splat")
    assert found["texture swapped", "splat"] < splat - 1
    for change in changes:
        assert found[change, "denoised"] > found[change, "splat"] + 5
