"""`hybrid scenes` and `hybrid doctor`."""

from __future__ import annotations

import json
import os

import pytest

from hybrid.cli.doctor import doctor
from hybrid.cli.scenes import scenes
from tests.hybrid.command import run

LENS = """<scene version="3.0.0"><emitter type="constant"/>
<integrator type="path"><integer name="max_depth" value="8"/></integrator>
<sensor type="thinlens"><float name="aperture_radius" value="{}"/><float name="focus_distance" value="9"/>
<film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/></film></sensor>
<shape type="sphere"><point name="center" x="0" y="0" z="3"/><bsdf type="diffuse"/></shape></scene>"""
pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_scenes_are_listed_with_their_facts(monkeypatch, capsys, tmp_path):
    assert run(monkeypatch, scenes.__name__, "--json", tmp_path / "s.json") == 0
    rows = {row["scene"]: row for row in json.loads((tmp_path / "s.json").read_text())}
    assert {"room", "cornell"} <= {*rows}
    room = rows["room"]
    assert 20_500 <= room["triangles"] <= 21_500
    assert room["emitters"] > 0
    assert (room["forest"], room["trees"], room["nodes_per_layer"]) == (None, 0, [])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(rows)
    line = next(line for line in lines if line.startswith("room: "))
    size = f"{room['width']} x {room['height']}"
    assert line == (
        f"room: {room['triangles']:,} triangles, {room['emitters']} emitters, depth {room['max_depth']}, "
        f"{size}, no forest yet"
    )


def test_the_newest_forest_of_a_scene_is_named(made, monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("HYBRID_HOME", str(made / "home"))
    assert run(monkeypatch, "scenes", "--json", tmp_path / "s.json") == 0
    row = next(row for row in json.loads((tmp_path / "s.json").read_text()) if row["scene"] == "cornell")
    assert os.path.basename(row["forest"]) == "box.safetensors"
    assert row["trees"] == row["nodes_per_layer"][0] > 0
    shown = capsys.readouterr().out
    layers = " + ".join(f"{count:,}" for count in row["nodes_per_layer"])
    assert f"forest {row['forest']}: {row['trees']:,} trees, layers of {layers} nodes" in shown


@pytest.mark.parametrize(("radius", "differs"), [(1e-4, False), (0.5, True)])
def test_what_a_scene_leaves_out_is_said_once(radius, differs, monkeypatch, capsys, tmp_path):
    (tmp_path / "lens.xml").write_text(LENS.format(radius))
    assert run(monkeypatch, "scenes", tmp_path / "lens.xml", "--json", tmp_path / "s.json") == 0
    shown, remark = capsys.readouterr(), "depth of field is left out; the thin lens counts as a pinhole"
    assert shown.err == ""
    assert shown.out.count("depth of field") == 1
    assert shown.out.splitlines()[1] == remark
    assert ("\n  what is left out may be why\n" in shown.out) == differs
    found = json.loads((tmp_path / "s.json").read_text())
    assert found["left_out"] == [remark]
    assert found["parity"]["causes"] == []
    assert (found["parity"]["differing"] > 0) == differs


def test_the_doctor_says_what_runs(monkeypatch, capsys, tmp_path):
    assert run(monkeypatch, doctor.__name__, "--json", tmp_path / "d.json") == 0
    assert "kernel: runs" in capsys.readouterr().out
    assert json.loads((tmp_path / "d.json").read_text())["kernel"] == "runs"


def test_the_doctor_lists_the_facts_before_the_problem(monkeypatch, capsys, tmp_path):
    ill = {"torch": "missing"}, "missing packages; run: pip install torch"
    monkeypatch.setattr("hybrid.cli.doctor.examine", lambda choice: ill)
    assert run(monkeypatch, "doctor", "--json", tmp_path / "d.json") == 2
    shown = capsys.readouterr()
    assert shown.out == "torch: missing\n"
    assert shown.err == "hybrid: missing packages; run: pip install torch\n"
    assert json.loads((tmp_path / "d.json").read_text()) == {"torch": "missing"}
