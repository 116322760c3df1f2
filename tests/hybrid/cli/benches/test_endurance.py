"""`hybrid bench endurance`."""

from __future__ import annotations

import json

import pytest

from hybrid.bench import endurance as bench
from hybrid.cli.benches.endurance import endurance as command
from tests.extremes import extreme
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


@extreme(
    "frame after many frames",
    given="120 frames along a gaze trace, the first one repeated after each 40",
    expected="the first frame again, to the last bit, and no kernel compiled anew",
)
def test_later_blocks_repeat_the_first_picture(made, monkeypatch, tmp_path, capsys, got, backend):
    monkeypatch.setattr(bench, "BLOCK", 40)
    # The same gazes in each block, so that each kind of frame has been there once after the first one.
    monkeypatch.setattr("hybrid.cli.benches.endurance._TRACE", 40 / 60)
    out = tmp_path / "e.json"
    common = ["bench", command.__name__, "cornell", "--forest", made / "box.forest", "--size", 96, 64]
    assert run(monkeypatch, *common, "--frames", 120, "--json", out) == 0
    found = json.loads(out.read_text())
    assert [row["frames"] for row in found["blocks"]] == [40, 80, 120]
    assert all(row["memory"] > 50 and row["milliseconds"] > 0 for row in found["blocks"])
    assert found["blocks"][0]["compiled"] > 0
    assert got(found["drift"], "g") == 0
    assert got(found["late_compiled"]) == 0
    assert "120" in capsys.readouterr().out
