"""The commands: the whole way in small, and one clear line for each mistake."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from PIL import Image

from hybrid.cli.main import app
from hybrid.output.images import read_layers
from splat.io.forest_file import load_forest, save_forest
from splat.io.ply import save_ply
from tests.conftest import real_file
from tests.hybrid.command import TINY_CAPTURE, TINY_TRAINING, run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_train_reports_what_it_measured(made, monkeypatch, tmp_path):
    out = tmp_path / "t.json"
    assert run(monkeypatch, "train", made / "frames", tmp_path / "f", *TINY_TRAINING, "--json", out) == 0
    row = json.loads(out.read_text())
    assert [layer["layer"] for layer in row["layers"]] == [1, 2]
    for layer in row["layers"]:
        assert layer["psnr"] > 10
        assert 0 < layer["ssim"] <= 1
    assert row["layers"][1]["nodes"] > row["layers"][0]["nodes"] == row["trees"] > 50
    assert row["seconds"] > 0


def test_render_writes_both_kinds_of_picture(made, monkeypatch, tmp_path):
    common = ["render", "cornell", "--forest", made / "box.forest", "--size", 60, 40, "--gaze", 0.3, 0.6]
    assert run(monkeypatch, *common, "-o", tmp_path / "a.exr", "--json", tmp_path / "a.json") == 0
    assert run(monkeypatch, *common, "-o", tmp_path / "a.png", "--fovea", "raw") == 0
    layers = read_layers(tmp_path / "a.exr")
    assert layers["composite.R"].shape == (40, 60)
    assert np.isfinite(layers["composite.R"]).all()
    wanted = {"fovea.R", "variance.G", "denoised.B", "fusion.traced.V", "fusion.denoised.V", "fusion.splat.V"}
    assert wanted <= set(layers)
    assert Image.open(tmp_path / "a.png").size == (60, 40)
    assert json.loads((tmp_path / "a.json").read_text())["milliseconds"]["total"] > 0


def test_render_shows_what_the_eye_resolves(made, monkeypatch, tmp_path):
    common = ["render", "cornell", "--forest", made / "box.forest", "--size", 320, 200, "--fov-a", 9]
    common += ["--fov-b", 6, "--display", "hmd"]
    out = tmp_path / "a.json"
    detail = ["--detail", tmp_path / "d.png", "--json", out]
    assert run(monkeypatch, *common, "--acuity-model", "fov-gs", "-o", tmp_path / "a.exr", *detail) == 0
    layers = read_layers(tmp_path / "a.exr")
    assert layers["level.V"].min() < 2
    assert layers["rate.V"].max() >= 1
    picture = np.asarray(Image.open(tmp_path / "d.png"))
    assert picture.shape[0] > 200
    assert picture.shape[1] == 320
    assert json.loads(out.read_text())["pixels_per_degree"] == pytest.approx(11.1, abs=0.1)
    # The coarsest layer alone is what `--layers 1 1` draws.
    assert run(monkeypatch, *common, "--layers", 1, 1, "-o", tmp_path / "b.exr") == 0
    assert (read_layers(tmp_path / "b.exr")["level.V"] == 1).all()


def test_bench_periphery_writes_a_row_per_law_and_gaze(made, monkeypatch, tmp_path):
    display, out = tmp_path / "display.json", tmp_path / "p.json"
    display.write_text(json.dumps({"width": 192, "height": 128, "fov": 60}))
    common = ["bench", "periphery", "cornell", "--forest", made / "box.forest", "--display", display]
    assert run(monkeypatch, *common, "--repeats", 3, "--warm-up", 1, "--json", out) == 0
    rows = json.loads(out.read_text())
    assert [(row["acuity_model"], row["gaze"]) for row in rows[:4]] == [
        (acuity_model, [0.5, 0.5]) for acuity_model in ("fov-gs", "stelacsf", "geisler-perry", "none")
    ]
    assert len(rows) == 8
    for row in rows:
        names = "law gaze width height periphery_ms full_ms ratio nodes_drawn jod ssim"
        assert set(names.split()) <= set(row)
        for name in ("periphery_ms", "full_ms", "moving_ms", "moving_full_ms"):
            assert 0 < row[name]["p50"] <= row[name]["p95"]
        if row["acuity_model"] == "none":
            assert row["ratio"] == 1
            assert row["ssim"] == pytest.approx(1)


def test_bench_forest_grows_loads_and_renders(monkeypatch, tmp_path):
    out = tmp_path / "f.json"
    assert run(monkeypatch, "bench", "forest", "--nodes", 3000, "--json", out) == 0
    row = json.loads(out.read_text())
    assert row["layers"][-1] == 3000
    assert row["layers"] == sorted(row["layers"])
    assert row["nodes_drawn"] > 0
    assert row["build_s"] > 0
    assert row["load_s"] > 0
    assert row["peak_bytes"] > 1e8


def test_bench_gaze_tells_how_much_a_step_changes(made, monkeypatch, tmp_path, capsys):
    display, out = tmp_path / "display.json", tmp_path / "g.json"
    display.write_text(json.dumps({"width": 192, "height": 128, "fov": 60}))
    common = ["bench", "gaze", "cornell", "--forest", made / "box.forest", "--display", display]
    assert run(monkeypatch, *common, "--step", 2, "--span", 6, "--json", out) == 0
    rows = json.loads(out.read_text())
    assert [row["acuity_model"] for row in rows] == ["fov-gs", "stelacsf", "geisler-perry"]
    for row in rows:
        assert 0 <= row["median_change_p99_9"] <= row["change_p99_9"] <= row["change_max"] < 255
    assert rows[0]["change_max"] > 0
    assert run(monkeypatch, *common, "--step", 2, "--span", 1) == 2
    assert "--span 1.0: must be at least one --step, 2.0" in capsys.readouterr().err


def test_bench_passes_times_each_pass_of_each_mode(made, monkeypatch, tmp_path, capsys):
    out = tmp_path / "p.json"
    common = ["bench", "passes", "cornell", "--forest", made / "box.forest", "--json", out]
    assert run(monkeypatch, *common, "--size", 96, 64, "--repeats", 3, "--warm-up", 1) == 0
    rows = {row["mode"]: row for row in json.loads(out.read_text())}
    assert list(rows) == ["raw", "denoised", "fused"]
    for row in rows.values():
        assert (row["width"], row["height"], row["spp"], row["repeats"]) == (96, 64, 2, 3)
        passes = row["passes"]
        assert list(passes) == ["plan", "detail", "splat", "under", "trace", "fovea", "blend", "total"]
        assert sum(passes[name]["p50"] for name in list(passes)[:-1]) < 2 * passes["total"]["p95"]
    assert rows["fused"]["passes"]["fovea"]["p50"] > 10 * rows["raw"]["passes"]["fovea"]["p50"]
    assert rows["fused"]["share_of_tracing"] > rows["raw"]["share_of_tracing"]
    assert run(monkeypatch, *common, "--size", 0, 64) == 2
    assert "--size 0 64: must be positive" in capsys.readouterr().err


def test_bench_still_gets_better_while_nothing_moves(made, monkeypatch, tmp_path, capsys):
    out = tmp_path / "s.json"
    common = ["bench", "still", "cornell", "--forest", made / "box.forest", "--size", 96, 64, "--json", out]
    assert run(monkeypatch, *common, "--seconds", 3, "--reference-spp", 256) == 0
    found = json.loads(out.read_text())
    frames = found["frames"]
    assert frames[-1]["seconds"] >= 3
    assert frames[-1]["spp"] > 10 * frames[0]["spp"]
    assert frames[-1]["psnr"] > frames[0]["psnr"] + 3
    assert 0 <= found["most_fall"] < 3
    assert found["reference_psnr"] > frames[0]["psnr"]
    assert run(monkeypatch, *common, "--gaze", 1.5, 0.5) == 2
    assert "gaze 1.5 0.5: lies outside the frame" in capsys.readouterr().err


def bench_of_fovea(name: str, made, monkeypatch, out, *options: object) -> list[dict]:
    """Rows of a bench of the fovea on the view that nothing was fitted to."""
    common = ["cornell", made / "frames", made / "box.forest", "--reference-spp", 4, "--json", out]
    assert run(monkeypatch, "bench", name, *common, *options) == 0
    return json.loads(out.read_text())


def test_bench_fusion_has_a_row_per_scale_count_and_method(made, monkeypatch, tmp_path):
    options = ["--spp", 1, "--spp", 4, "--seeds", 1]
    rows = bench_of_fovea("fusion", made, monkeypatch, tmp_path / "b.json", *options)
    methods = ["splat", "raw", "denoised", "mean", "statistical", "fused, even", "fused"]
    keys = [(row["scale"], row["spp"], row["method"]) for row in rows]
    assert keys == [(scale, spp, method) for scale in (1, 2) for spp in (1, 4) for method in methods]
    by_key = dict(zip(keys, rows, strict=True))
    assert by_key[1, 1, "splat"]["psnr"] == by_key[1, 4, "splat"]["psnr"]
    assert by_key[1, 4, "raw"]["psnr"] > by_key[1, 1, "raw"]["psnr"]
    # Few samples go everywhere.
    assert by_key[2, 1, "fused"]["psnr"] == by_key[2, 1, "fused, even"]["psnr"]
    assert all(row["views"] == 1 and row["reference_psnr"] > 10 for row in rows)


def test_bench_change_changes_what_is_traced_and_not_the_splats(made, monkeypatch, tmp_path):
    rows = bench_of_fovea("change", made, monkeypatch, tmp_path / "b.json", "--spp", 4)
    found = {(row["change"], row["method"]): row["psnr"] for row in rows}
    changes = {change for change, _ in found}
    assert changes == {"object moved", "texture swapped", "lamp dimmed"}
    unchanged = bench_of_fovea("fusion", made, monkeypatch, tmp_path / "f.json", "--spp", 4, "--seeds", 1)
    splat = next(row["psnr"] for row in unchanged if row["scale"] == 1 and row["method"] == "splat")
    assert found["texture swapped", "splat"] < splat - 1
    for change in changes:
        assert found[change, "denoised"] > found[change, "splat"] + 5


def test_bench_motion_compares_a_walk_with_single_frames(made, monkeypatch, tmp_path):
    rows = bench_of_fovea("motion", made, monkeypatch, tmp_path / "b.json")
    found = {(row["mode"], row["method"]): row["psnr"] for row in rows}
    assert len(found) == 9
    assert found["raw", "16 frames of 1 spp"] > found["raw", "single frame, 1 spp"] + 3


def test_bench_seam_has_a_row_per_mode(made, monkeypatch, tmp_path, capsys):
    display = tmp_path / "d.json"
    display.write_text(json.dumps({"width": 64, "height": 64, "fov": 40}))
    rows = bench_of_fovea("seam", made, monkeypatch, tmp_path / "b.json", "--display", display)
    assert [row["mode"] for row in rows] == ["raw", "denoised", "fused"]
    assert all(np.isfinite(row["difference"]) and row["sectors"] >= 0 for row in rows)
    assert "inner against outer side" in capsys.readouterr().out


@pytest.fixture
def of_room(made, tmp_path):
    """The forest and the frame set of the Cornell box, as if they were those of another scene."""
    forest = load_forest(made / "box.forest")
    save_forest(tmp_path / "room.forest", replace(forest, scene_name="room", scene_hash="cd" * 32))
    shutil.copytree(made / "frames", tmp_path / "room-frames")
    description = tmp_path / "room-frames" / "transforms.json"
    document = json.loads(description.read_text())
    document["scene"] |= {"name": "room", "hash": "cd" * 32}
    description.write_text(json.dumps(document))
    return tmp_path


@pytest.mark.parametrize("name", ["fusion", "change", "motion", "seam"])
def test_benches_refuse_what_is_not_of_their_scene(name, made, of_room, monkeypatch, capsys):
    for frames, forest, named in (
        (made / "frames", of_room / "room.forest", "room.forest is one of scene room"),
        (of_room / "room-frames", made / "box.forest", "room-frames is one of scene room"),
    ):
        assert run(monkeypatch, "bench", name, "cornell", frames, forest) == 2
        message = capsys.readouterr().err
        assert named in message
        assert message.count("\n") == 1


def test_benches_without_frames_refuse_a_forest_of_another_scene(made, of_room, monkeypatch, capsys):
    room = of_room / "room.forest"
    for arguments in (
        ["bench", "held-out", made / "frames", room],
        ["bench", "periphery", "cornell", "--forest", room],
        ["bench", "gaze", "cornell", "--forest", room],
        ["evaluate", "cornell", "--report", of_room / "r", "--peer-forest", room],
    ):
        assert run(monkeypatch, *arguments) == 2
        message = capsys.readouterr().err
        assert "room.forest is one of scene room" in message
        assert message.count("\n") == 1


def test_bench_held_out_exchanges_the_periphery_alone(made, monkeypatch, tmp_path):
    out = tmp_path / "h.json"
    common = ["bench", "held-out", made / "frames", made / "box.forest", "--json", out]
    assert run(monkeypatch, *common, "--fov-b", 20) == 0
    rows = json.loads(out.read_text())
    assert [row["views"] for row in rows] == [3] * 4
    assert run(monkeypatch, *common, "--fov-b", 100) == 0
    whole = json.loads(out.read_text())
    for part, same in zip(rows, whole, strict=True):
        assert part["psnr"] < 60 < same["psnr"]
        assert same["ssim"] == pytest.approx(1)


def test_a_layer_is_exported_by_its_number(made, monkeypatch, tmp_path, capsys):
    assert run(monkeypatch, "export", made / "box.forest", tmp_path / "a.ply", "--layer", 1) == 0
    assert "layer 1," in capsys.readouterr().out
    assert run(monkeypatch, "export", made / "box.forest", tmp_path / "b.ply") == 0
    assert (tmp_path / "b.ply").stat().st_size > (tmp_path / "a.ply").stat().st_size


def test_render_takes_a_camera_of_transforms_json(made, monkeypatch, tmp_path):
    document = json.loads((made / "frames" / "transforms.json").read_text())
    camera = {k: document[k] for k in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
    camera["transform_matrix"] = document["frames"][2]["transform_matrix"]
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    common = ["render", "cornell", "--forest", made / "box.forest", "--fov-a", 0, "--fov-b", 0]
    assert run(monkeypatch, *common, "--camera", tmp_path / "camera.json", "-o", tmp_path / "a.png") == 0
    assert Image.open(tmp_path / "a.png").size == (32, 32)


def test_without_a_name_the_newest_forest_of_the_scene_is_taken(made, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("HYBRID_HOME", str(made / "home"))
    assert run(monkeypatch, "render", "cornell", "--size", 40, 40, "-o", tmp_path / "a.png") == 0
    assert "training one first" not in capsys.readouterr().err
    assert run(monkeypatch, "scenes") == 0
    out = capsys.readouterr().out
    assert "box.safetensors" in out
    assert "trees, layers of" in out


def test_export_and_import_there_and_back(made, monkeypatch, tmp_path):
    assert run(monkeypatch, "export", made / "box.forest", tmp_path / "a.ply") == 0
    assert run(monkeypatch, "import", tmp_path / "a.ply", tmp_path / "b.forest") == 0
    assert (
        run(monkeypatch, "render", "cornell", "--forest", tmp_path / "b.forest", "-o", tmp_path / "b.png")
        == 0
    )


def test_a_real_ply_goes_through_import(monkeypatch, tmp_path):
    source = real_file("splats/kacytran_try_it7000.ply")
    assert run(monkeypatch, "import", source, tmp_path / "k.forest") == 0
    assert run(monkeypatch, "export", tmp_path / "k.forest", tmp_path / "k.ply") == 0


def test_bench_raster_writes_its_row(monkeypatch, tmp_path):
    out = tmp_path / "b.json"
    size = ["--gaussians", 500, "--size", 64, 48, "--repeats", 3]
    assert run(monkeypatch, "bench", "raster", *size, "--json", out) == 0
    row = json.loads(out.read_text())
    assert row["pairs"] > 500
    assert row["forward_ms"]["p50"] > 0
    assert row["backward_ms"]["p95"] >= row["backward_ms"]["p50"]


def test_scenes_and_doctor_say_what_is_there(monkeypatch, capsys, tmp_path):
    assert run(monkeypatch, "scenes", "--json", tmp_path / "s.json") == 0
    rows = {row["scene"]: row for row in json.loads((tmp_path / "s.json").read_text())}
    assert 20_500 <= rows["room"]["triangles"] <= 21_500
    capsys.readouterr()
    assert run(monkeypatch, "doctor") == 0
    assert "kernel: runs" in capsys.readouterr().out


@pytest.mark.parametrize(("scene", "textured"), [("room", True), ("cornell", False)])
def test_quickstart_writes_everything(scene, textured, monkeypatch, tmp_path):
    """The main job itself, with settings that take seconds; what cannot be measured is left out."""
    import hybrid.measure.metrics.registration
    import hybrid.quickstart.quickstart
    import hybrid.training.quick
    from pathtrace.dataset.settings import CaptureSettings
    from splat.training.trainer import TrainingSettings

    monkeypatch.setattr(
        hybrid.training.quick,
        "QUICK_CAPTURE",
        CaptureSettings(views=4, held_out=1, width=32, height=32, spp=2, held_out_spp=4),
    )
    monkeypatch.setattr(
        hybrid.training.quick, "QUICK_TRAINING", TrainingSettings(iterations=20, gaussians=500, layers=2)
    )
    monkeypatch.setattr(hybrid.quickstart.quickstart, "SIZE", 128)
    if not textured:
        monkeypatch.setattr(hybrid.measure.metrics.registration, "_TEXTURE", 10.0)
    monkeypatch.setattr(hybrid.quickstart.quickstart, "_REFERENCE_SPP", 4)
    out = tmp_path / "out"
    assert run(monkeypatch, "quickstart", scene, "--out", out) == 0
    wanted = {"hybrid.exr", "hybrid.png", "reference.png", "splat.png", "result.json", "index.html"}
    assert wanted <= {p.name for p in out.iterdir()}
    result = json.loads((out / "result.json").read_text())
    names = "scene width height spp fov_a fov_b seconds splat hybrid hybrid_ms path_traced_ms ratio covered"
    assert {*names.split(), "ceiling"} <= set(result)
    assert ("registration_px" in result) == textured
    assert set(result["seconds"]) == {"capture", "train", "render", "total"}
    page = (out / "index.html").read_text()
    assert page.count("data:image/png;base64,") == 4
    assert f"{result['hybrid']['psnr']:.2f} dB" in page
    assert "http" not in page.replace("http-equiv", "")


MISTAKES = {
    "a missing scene": (["render", "nowhere.xml", "-o", "{tmp}/a.png"], "nowhere.xml"),
    "an XML that Mitsuba refuses": (["capture", "{tmp}/bad.xml", "{tmp}/frames"], "bad.xml"),
    "a missing forest": (["render", "cornell", "--forest", "{tmp}/none", "-o", "{tmp}/a.png"], "none"),
    "a forest of another scene": (
        ["render", "room", "--forest", "{made}/box.forest", "-o", "{tmp}/a.png"],
        "box.forest is one of scene cornell",
    ),
    "a forest of another depth": (
        ["render", "cornell", "--forest", "{made}/box.forest", "--max-depth", "2", "-o", "{tmp}/a.png"],
        "--max-depth is another one",
    ),
    "a target at another depth": (
        ["render", "cornell", "--max-depth", "2", "--target-ms", "9", "-o", "{tmp}/a.png"],
        "--max-depth",
    ),
    "a truncated forest": (["render", "cornell", "--forest", "{tmp}/cut", "-o", "{tmp}/a.png"], "cut"),
    "a corrupt forest": (["export", "{tmp}/corrupt", "{tmp}/a.ply"], "corrupt"),
    "fov-b > fov-a": (
        ["render", "cornell", "--fov-a", "5", "--fov-b", "9", "-o", "{tmp}/a.png"],
        "--fov-b 9",
    ),
    "no disc to show": (
        ["quickstart", "cornell", "--out", "{tmp}/o", "--fov-a", "0", "--fov-b", "0"],
        "--fov-a 0.0: there is no fovea",
    ),
    "a disc without a pixel": (
        ["quickstart", "cornell", "--out", "{tmp}/o", "--fov-a", "0.05", "--fov-b", "0"],
        "--fov-a 0.05: there is no fovea",
    ),
    "no periphery to watch": (["bench", "gaze", "cornell", "--fov-b", "200"], "--fov-b 200.0: covers"),
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
    "an unknown sweep": (["sweep", "cornell", "--over", "colour"], "--over colour"),
    "JSON into what is no folder": (["scenes", "--json", "{tmp}/cut/a.json"], "--json {tmp}/cut/a.json"),
    "JSON into a folder": (["doctor", "--json", "{tmp}"], "--json {tmp}"),
    "JSON without a name": (["doctor", "--json", ""], "--json .: cannot be written"),
    "JSON of a bench": (["bench", "forest", "--json", "."], "--json .: cannot be written"),
    "a PLY without a name": (["export", "{made}/box.forest", "."], ".: names a folder"),
    "an imported forest without a name": (["import", "{tmp}/good.ply", "."], ".: names a folder"),
    "a PLY of x Gaussians": (["import", "{tmp}/x.ply", "{tmp}/f"], "x.ply: element vertex x"),
    "a file that is no PLY": (["import", "{tmp}/cut", "{tmp}/f"], "cut"),
    "an unknown backend": (["doctor", "--backend", "metal"], "backend metal"),
    "a layer that is not there": (
        ["export", "{made}/box.forest", "{tmp}/a.ply", "--layer", "3"],
        "--layer 3",
    ),
    "layers that are not there": (
        ["render", "cornell", "--forest", "{made}/box.forest", "--layers", "2", "3", "-o", "{tmp}/a.png"],
        "--layers 2 3",
    ),
    "zero layers": (["train", "{made}/frames", "{tmp}/f", "--layers", "0"], "layers is 0"),
    "more layers than pixels": (["train", "{made}/frames", "{tmp}/f", "--layers", "4"], "allow 2"),
    "an unknown law": (
        ["render", "cornell", "--acuity-model", "blur", "-o", "{tmp}/a.png"],
        "acuity model blur",
    ),
    "an unknown fovea": (["render", "cornell", "--fovea", "sharp", "-o", "{tmp}/a.png"], "--fovea sharp"),
    "an unknown display": (["bench", "periphery", "cornell", "--display", "wall"], "display wall"),
    "a damaged camera": (
        ["render", "cornell", "--camera", "{tmp}/bad.xml", "-o", "{tmp}/a.png"],
        "--camera",
    ),
    "a camera of half a pixel": (
        ["render", "cornell", "--camera", "{tmp}/half.json", "-o", "{tmp}/a.png"],
        "w is 32.5; must be a whole number of pixels",
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


def test_json_is_checked_before_the_work_by_every_command_but_export_and_import():
    commands = dict(typer.main.get_command(app).commands)
    commands |= commands.pop("bench").commands
    checks = {
        name: parameter.callback
        for name, command in commands.items()
        for parameter in command.params
        if "--json" in parameter.opts
    }
    assert {*commands} - {*checks} == {"export", "import"}
    assert all(checks.values())


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


@pytest.mark.parametrize("name", ["staircase2", "veach-bidir"])
def test_scenes_in_the_wild_go_through_every_command(name, monkeypatch, tmp_path):
    scene = real_file(f"scenes/{name}/scene.xml")
    assert run(monkeypatch, "capture", scene, tmp_path / "frames", *TINY_CAPTURE) == 0
    assert run(monkeypatch, "train", tmp_path / "frames", tmp_path / "f", *TINY_TRAINING) == 0
    common = [scene, "--forest", tmp_path / "f", "--size", 64, 48]
    assert run(monkeypatch, "render", *common, "-o", tmp_path / "a.exr") == 0
    layers = read_layers(tmp_path / "a.exr")
    assert all(np.isfinite(layers[f"composite.{c}"]).all() for c in "RGB")
    assert layers["composite.G"].mean() > 0.01
    assert run(monkeypatch, "export", tmp_path / "f", tmp_path / "a.ply") == 0
