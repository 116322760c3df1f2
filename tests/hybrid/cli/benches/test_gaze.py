"""`hybrid bench gaze`."""

from __future__ import annotations

import json

import pytest

from hybrid.cli.benches.gaze import gaze as command
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_the_change_per_step_is_measured_for_each_acuity_model(made, display, monkeypatch, tmp_path, capsys):
    out = tmp_path / "g.json"
    common = ["bench", command.__name__, "cornell", "--forest", made / "box.forest", "--display", display]
    assert run(monkeypatch, *common, "--step", 2, "--span", 6, "--json", out) == 0
    rows = json.loads(out.read_text())
    assert [row["acuity_model"] for row in rows] == ["fov-gs", "stelacsf", "geisler-perry", "fovvideovdp"]
    for row in rows:
        assert 0 <= row["median_change_p99_9"] <= row["change_p99_9"] <= row["change_max"] < 255
        assert (row["step_degrees"], row["span_degrees"], row["scene"]) == (2, 6, "cornell")
    assert rows[0]["change_max"] > 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[1].split() == ["fov-gs", f"{rows[0]['change_p99_9']:.2f}", f"{rows[0]['change_max']:.2f}"]
