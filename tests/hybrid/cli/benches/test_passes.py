"""`hybrid bench passes`."""

from __future__ import annotations

import json

import pytest

from hybrid.cli.benches.passes import passes as command
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_each_pass_of_each_mode_is_timed(made, monkeypatch, tmp_path, capsys):
    out = tmp_path / "p.json"
    common = ["bench", command.__name__, "cornell", "--forest", made / "box.forest", "--json", out]
    assert run(monkeypatch, *common, "--size", 96, 64, "--repeats", 3, "--warm-up", 1) == 0
    rows = {row["mode"]: row for row in json.loads(out.read_text())}
    assert list(rows) == ["raw", "denoised", "fused"]
    names = ["region", "detail", "splat", "fill", "trace", "fovea", "blend", "total"]
    for row in rows.values():
        assert (row["width"], row["height"], row["spp"], row["repeats"]) == (96, 64, 2, 3)
        passes = row["passes"]
        assert list(passes) == names
        assert sum(passes[name]["p50"] for name in names[:-1]) < 2 * passes["total"]["p95"]
    assert rows["fused"]["passes"]["fovea"]["p50"] > 10 * rows["raw"]["passes"]["fovea"]["p50"]
    assert rows["fused"]["share_of_tracing"] > rows["raw"]["share_of_tracing"]
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].split()[1:9] == names
    assert [line.split()[0] for line in shown[1:]] == list(rows)
