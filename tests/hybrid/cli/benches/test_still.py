"""`hybrid bench still`."""

from __future__ import annotations

import json

import pytest

from hybrid.cli.benches.still import still as command
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_the_disc_gets_better_while_nothing_moves(made, monkeypatch, tmp_path, capsys):
    out = tmp_path / "s.json"
    common = ["bench", command.__name__, "cornell", "--forest", made / "box.forest", "--size", 96, 64]
    assert run(monkeypatch, *common, "--seconds", 3, "--reference-spp", 256, "--json", out) == 0
    found = json.loads(out.read_text())
    frames = found["frames"]
    assert frames[-1]["seconds"] >= 3
    assert frames[-1]["spp"] > 10 * frames[0]["spp"]
    assert frames[-1]["psnr"] > frames[0]["psnr"] + 3
    assert 0 <= found["most_fall"] < 3
    assert found["reference_psnr"] > frames[0]["psnr"]
    shown = capsys.readouterr().out.splitlines()
    # The first frame, and the last ones within one and two seconds.
    assert len(shown) == 1 + 3 + 2
    assert f"{frames[0]['psnr']:.2f} dB" in shown[1]
    assert f"{found['reference_psnr']:.2f} dB" in shown[4]
