"""One clear line for each mistake, exit code 2, and nothing half-written."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from splat.io.forest_file import load_forest
from splat.io.ply import save_ply
from tests.hybrid.command import run

pytestmark = pytest.mark.usefixtures("backend", "own_home")

MISTAKES = {
    "a missing scene": (["render", "nowhere.xml", "-o", "{tmp}/a.png"], "nowhere.xml"),
    "an XML that Mitsuba refuses": (["capture", "{tmp}/bad.xml", "{tmp}/frames"], "bad.xml"),
    "a missing forest": (["render", "cornell", "--forest", "{tmp}/none", "-o", "{tmp}/a.png"], "none"),
    "a forest of another scene": (
        ["render", "room", "--forest", "{made}/box.forest", "-o", "{tmp}/a.png"],
        "box.forest belongs to scene cornell",
    ),
    "a forest of another depth": (
        ["render", "cornell", "--forest", "{made}/box.forest", "--max-depth", "2", "-o", "{tmp}/a.png"],
        "the scene or its path depth has changed",
    ),
    "a target at another depth": (
        ["render", "cornell", "--max-depth", "2", "--target-ms", "9", "-o", "{tmp}/a.png"],
        "--max-depth",
    ),
    "a truncated forest": (["render", "cornell", "--forest", "{tmp}/cut", "-o", "{tmp}/a.png"], "cut"),
    "a corrupt forest": (["export", "{tmp}/corrupt", "{tmp}/a.ply"], "corrupt"),
    "fov-b > fov-a": (
        ["render", "cornell", "--fov-a", "5", "--fov-b", "9", "-o", "{tmp}/a.png"],
        "fov-b 9.0: must be at most fov-a 5.0",
    ),
    "no disc to show": (
        ["quickstart", "cornell", "--out", "{tmp}/o", "--fov-a", "0", "--fov-b", "0"],
        "--fov-a 0.0: there is no fovea",
    ),
    "a disc without a pixel": (
        ["quickstart", "cornell", "--out", "{tmp}/o", "--fov-a", "0.05", "--fov-b", "0"],
        "--fov-a 0.05: there is no fovea",
    ),
    "a gaze that is no number": (
        ["render", "cornell", "--gaze", "nan", "0.5", "-o", "{tmp}/a.png"],
        "gaze",
    ),
    "the rate of a single frame": (["render", "cornell", "--fps", "30", "-o", "{tmp}/a.png"], "--fps 30"),
    "a size of zero": (
        ["render", "cornell", "--forest", "{made}/box.forest", "--size", "0", "9", "-o", "{tmp}/a.png"],
        "--size 0 9",
    ),
    "a negative size": (["capture", "cornell", "{tmp}/frames", "--size", "-3", "9"], "width is -3"),
    "no views": (["capture", "cornell", "{tmp}/frames", "--views", "0"], "views is 0"),
    "samples below one": (["render", "cornell", "--spp", "0", "-o", "{tmp}/a.png"], "--spp"),
    "an unknown kind of file": (["render", "cornell", "-o", "{tmp}/a.jpg"], "a.jpg"),
    "an output folder that is a file": (["render", "cornell", "-o", "{tmp}/cut/a.png"], "cut"),
    "a training folder that is a file": (["train", "{made}/frames", "{tmp}/cut/f"], "cut"),
    "no frame set": (["train", "{tmp}", "{tmp}/f"], "not a frame set"),
    "no iterations": (["train", "{made}/frames", "{tmp}/f", "--iterations", "0"], "iterations"),
    "an unknown sweep": (["sweep", "cornell", "--over", "colour"], "sweep over colour: must be over"),
    "JSON into what is no folder": (["scenes", "--json", "{tmp}/cut/a.json"], "--json {tmp}/cut/a.json"),
    "JSON into a folder": (["doctor", "--json", "{tmp}"], "--json {tmp}"),
    "JSON without a name": (["doctor", "--json", ""], "--json .: cannot be written"),
    "JSON of a bench": (["bench", "raster", "--json", "."], "--json .: cannot be written"),
    "a PLY without a name": (["export", "{made}/box.forest", "."], ".: must end in .glb"),
    "an imported forest without a name": (["import", "{tmp}/good.ply", "."], ".: names a folder"),
    "a PLY of x Gaussians": (["import", "{tmp}/x.ply", "{tmp}/f"], "x.ply: cannot be read (element vertex x"),
    "a file that is no PLY": (["import", "{tmp}/cut", "{tmp}/f"], "cut"),
    "an unknown backend": (["doctor", "--backend", "metal"], "backend metal"),
    "a layer that is not there": (
        ["export", "{made}/box.forest", "{tmp}/a.ply", "--layer", "3"],
        "--layer 3",
    ),
    "layers that are not there": (
        ["render", "cornell", "--forest", "{made}/box.forest", "--layers", "2", "3", "-o", "{tmp}/a.png"],
        "layers 2 3: this forest has layers 1 to 2",
    ),
    "zero layers": (["train", "{made}/frames", "{tmp}/f", "--layers", "0"], "layers is 0"),
    "more layers than pixels": (["train", "{made}/frames", "{tmp}/f", "--layers", "4"], "allow 2"),
    "an unknown acuity model": (
        ["render", "cornell", "--acuity-model", "blur", "-o", "{tmp}/a.png"],
        "acuity model blur: must be",
    ),
    "an unknown fovea": (
        ["render", "cornell", "--fovea", "sharp", "-o", "{tmp}/a.png"],
        "fovea sharp: must be raw, denoised or fused",
    ),
    "an unknown display": (["bench", "periphery", "cornell", "--display", "wall"], "display wall: must be"),
    "a damaged camera": (
        ["render", "cornell", "--camera", "{tmp}/bad.xml", "-o", "{tmp}/a.png"],
        "--camera",
    ),
    "a camera of half a pixel": (
        ["render", "cornell", "--camera", "{tmp}/half.json", "-o", "{tmp}/a.png"],
        "w is 32.5; must be a whole number of pixels",
    ),
    "a picture of levels of another kind": (
        ["render", "cornell", "--detail", "{tmp}/d.jpg", "-o", "{tmp}/a.png"],
        "--detail {tmp}/d.jpg: must end in .png",
    ),
    "a camera that is not there": (
        ["render", "cornell", "--camera", "{tmp}/none.json", "-o", "{tmp}/a.png"],
        "--camera {tmp}/none.json: cannot be read",
    ),
    "a gaze trace that is none": (
        ["render", "cornell", "--gaze-trace", "{tmp}/bad.xml", "-o", "{tmp}/a.mp4"],
        "bad.xml: is not a gaze trace",
    ),
    "a damaged display": (
        ["render", "cornell", "--display", "{tmp}/half.json", "-o", "{tmp}/a.png"],
        "half.json",
    ),
    "a bench of what stands still": (["bench", "moving", "cornell"], "cornell: nothing moves in this scene"),
    "a bench of no size": (
        ["bench", "frame", "cornell", "--forest", "{made}/box.forest", "--size", "0", "64"],
        "--size 0 64: must be positive",
    ),
    "a rasterizer of no size": (["bench", "raster", "--size", "0", "64"], "--size 0 64: must be positive"),
    "no fovea to sweep": (
        ["sweep", "cornell", "--over", "resolution", "--fov-a", "0", "--fov-b", "0"],
        "--fov-a 0.0: there is no fovea to time",
    ),
    "an option without influence": (
        ["sweep", "cornell", "--over", "denoiser", "--spp", "2"],
        "--spp: has no influence on a sweep --over denoiser",
    ),
    "paths where raw ones are no use": (
        ["render", "cornell", "--paths", "where-needed", "--fovea", "raw", "-o", "{tmp}/a.png"],
        "--paths where-needed: the fovea is raw",
    ),
    "paths that no target was measured with": (
        ["render", "cornell", "--paths", "where-needed", "--target-ms", "50", "-o", "{tmp}/a.png"],
        "nothing is measured with --paths where-needed",
    ),
    "a layer of all levels": (
        ["export", "{made}/box.forest", "{tmp}/a/lod-meta.json", "--layer", "1"],
        "--layer: lod-meta.json holds all levels of detail",
    ),
    "levels of no forest": (["levels", "{tmp}/corrupt"], "corrupt"),
    "layers and none": (
        ["render", "cornell", "--layers", "1", "2", "--level", "2", "-o", "{tmp}/a.png"],
        "--layers: --level, --gaussians and --level-jod draw no layers",
    ),
    "a quality that there is not": (
        ["render", "cornell", "--level-jod", "10", "-o", "{tmp}/a.png"],
        "level_jod 10: must be over 0 and below 10",
    ),
    "levels that no target was measured with": (
        ["render", "cornell", "--gaussians", "5000", "--target-ms", "50", "-o", "{tmp}/a.png"],
        "nothing is measured with --gaussians",
    ),
    "levels that a target would choose": (
        ["demo", "cornell", "--target", "30", "--level", "2"],
        "--target: chooses layers; leave out --level, --gaussians and --level-jod",
    ),
    "paths in an unknown place": (
        ["render", "cornell", "--paths", "everywhere", "-o", "{tmp}/a.png"],
        "paths everywhere: must be disc or where-needed",
    ),
    "a report that is none": (
        ["sweep", "cornell", "--report", "{tmp}"],
        "{tmp}",
    ),
    "an evaluation without a disc to compare": (
        ["evaluate", "cornell", "--report", "{tmp}/r", "--fov-b", "50"],
        "fov-b 50.0: must be at most fov-a 20.0",
    ),
    "a tiny window": (
        ["demo", "cornell", "--size", "64", "10", "--out", "{tmp}"],
        "--size 64 10: must be at",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_and_exit_code_2(mistake, made, monkeypatch, tmp_path, capsys):
    (tmp_path / "bad.xml").write_text("<scene version='3.0.0'><shape type='nonsense'/></scene>")
    (tmp_path / "cut").write_bytes((made / "box.forest").read_bytes()[:500])
    shutil.copy(made / "box.forest", tmp_path / "corrupt")
    with open(tmp_path / "corrupt", "r+b") as file:
        file.write(b"\xff" * 64)
    save_ply(tmp_path / "good.ply", load_forest(made / "box.forest").finest)
    camera = json.loads((made / "frames" / "transforms.json").read_text())
    pose = camera["frames"][0]["transform_matrix"]
    (tmp_path / "half.json").write_text(json.dumps({**camera, "transform_matrix": pose, "w": 32.5}))
    header = (tmp_path / "good.ply").read_bytes()
    (tmp_path / "x.ply").write_bytes(re.sub(rb"element vertex \d+", b"element vertex x", header))
    before = {p.relative_to(tmp_path) for p in tmp_path.rglob("*")}
    arguments, named = MISTAKES[mistake]
    named = named.format(tmp=tmp_path)
    filled = [a.format(tmp=tmp_path, made=made) for a in arguments]
    assert run(monkeypatch, *filled) == 2
    message = capsys.readouterr().err
    assert named in message
    assert "Traceback" not in message
    if message.startswith("hybrid:"):
        assert message.count("\n") == 1
    assert {p.relative_to(tmp_path) for p in tmp_path.rglob("*")} == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_named(made, monkeypatch, tmp_path, capsys):
    (tmp_path / "closed").mkdir(mode=0o500)
    output = tmp_path / "closed" / "a.png"
    assert run(monkeypatch, "render", "cornell", "--forest", made / "box.forest", "-o", output) == 2
    assert "closed" in capsys.readouterr().err


def shell(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, as a user starts it."""
    program = Path(sys.executable).with_name("hybrid")
    return subprocess.run(
        [program, *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        check=False,
    )


def test_no_usable_llvm_is_one_line(tmp_path):
    result = shell("scenes", "--backend", "llvm", DRJIT_LIBLLVM_PATH=str(tmp_path / "libLLVM-15.so"))
    assert result.returncode == 2
    assert result.stderr.startswith("hybrid: ")
    assert "pip install karellen-llvm-core" in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_target_at_another_depth_is_refused_before_anything_is_loaded(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("pathtrace.scene.scene.load_scene", None)
    options = ["--max-depth", 2, "--target-ms", 9, "-o", tmp_path / "a.png"]
    assert run(monkeypatch, "render", "cornell", *options) == 2
    assert "nothing is measured with --max-depth; leave it out" in capsys.readouterr().err


def test_commands_refuse_a_forest_of_another_scene(of_room, monkeypatch, capsys):
    room = of_room / "room.forest"
    for arguments in (
        ["bench", "periphery", "cornell", "--forest", room],
        ["bench", "frame", "cornell", "--forest", room],
        ["evaluate", "cornell", "--report", of_room / "r", "--baseline-forest", room],
    ):
        assert run(monkeypatch, *arguments) == 2
        message = capsys.readouterr().err
        assert "room.forest belongs to scene room" in message
        assert message.count("\n") == 1
