"""`hybrid train`."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from hybrid.base.cache_folder import keep_receipt, newest_forest
from hybrid.cli import train as command
from hybrid.preparation import forest_training as module
from hybrid.preparation.scene_plan import as_planned
from hybrid.render.forest_attachments import plan_of_forest
from pathtrace.dataset.frame_set import read_frame_set
from pathtrace.scene.scene import load_scene
from splat.io.forest_file import load_forest
from splat.model.choices import Precision
from splat.training.trainer import TrainingSettings
from tests.extremes import extreme
from tests.hybrid.command import TINY_TRAINING, run

pytestmark = pytest.mark.usefixtures("backend", "own_home")


def test_a_forest_is_written_stored_and_measured(made, monkeypatch, tmp_path, capsys):
    out = tmp_path / "t.json"
    keep_receipt(read_frame_set(made / "frames"))
    assert run(monkeypatch, "train", made / "frames", tmp_path / "f.a", *TINY_TRAINING, "--json", out) == 0
    row = json.loads(out.read_text())
    assert [layer["layer"] for layer in row["layers"]] == [1, 2]
    for layer in row["layers"]:
        assert layer["psnr"] > 10
        assert 0 < layer["ssim"] <= 1
    assert row["layers"][1]["nodes"] > row["layers"][0]["nodes"] == row["trees"] > 50
    assert row["seconds"] > 0
    assert row["left_out"] == {"frames": 0, "steps": 0}
    assert row["splat"] == {name: row["layers"][-1][name] for name in ("psnr", "ssim")}
    assert (row["scene"], row["iterations"]) == ("cornell", 40)
    stored = newest_forest(as_planned(load_scene("cornell")))
    assert stored.name == "f.safetensors"
    assert load_forest(stored).digest() == load_forest(tmp_path / "f.a").digest()
    planned = plan_of_forest(load_forest(stored))
    assert (planned["degree"], planned["layers"], planned["gaussians"]) == (1, 2, 400)
    assert planned["path depth"] == as_planned(load_scene("cornell")).max_depth
    shown = capsys.readouterr().out.splitlines()
    assert f"in {row['trees']:,} trees" in shown[0]
    assert shown[2].startswith(f"layer 2: {row['layers'][1]['nodes']:,} nodes, held-out views ")


@extreme(
    "a frame set that claims to show a scene",
    given="name and hash of a scene, but frames that were not captured here",
    expected="a forest, but not as the scene's newest one",
)
def test_frames_of_elsewhere_make_no_newest_forest(made, monkeypatch, tmp_path, capsys, got):
    assert run(monkeypatch, "train", made / "frames", tmp_path / "f.a", *TINY_TRAINING) == 0
    assert load_forest(tmp_path / "f.a").scene_name == "cornell"
    assert got(newest_forest(as_planned(load_scene("cornell")))) is None
    assert "frames was not captured with this cache folder" in capsys.readouterr().out


# Of the Cornell box on a desktop display: few edges, no texture, and a lamp that half precision holds.
PLANNED = TrainingSettings(layers=3, half_frames=True)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ([], (PLANNED, Precision.COMPACT)),
        (
            ["--iterations", 5, "--gaussians", 60, "--layers", 1, "--degree", 3, "--seed", 4],
            (TrainingSettings(5, 60, 1, 3, 4, half_frames=True), Precision.COMPACT),
        ),
        (["--precision", "float32"], (PLANNED, Precision.FLOAT32)),
    ],
)
def test_every_option_reaches_the_settings(options, expected, made, monkeypatch, tmp_path):
    given = []

    def train(frames, path, settings, progress, report, precision):
        given.extend([frames.folder, path, settings, precision])
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "train", train)
    assert run(monkeypatch, command.train.__name__, made / "frames", tmp_path / "f", *options) != 0
    settings, precision = expected
    if settings is PLANNED:
        gaussians = read_frame_set(made / "frames").plan["gaussians"]
        assert 4_000 < gaussians < 16_000
        settings = replace(PLANNED, gaussians=gaussians)
    assert given == [made / "frames", tmp_path / "f", settings, precision]


@extreme(
    "a motion learned from one time",
    given="--motion d-gs, frames of a still scene",
    expected="refused by name",
)
def test_a_motion_cannot_be_learned_from_frames_of_one_time(made, monkeypatch, tmp_path, capsys, got):
    options = ["train", made / "frames", tmp_path / "f", *TINY_TRAINING, "--motion", "d-gs"]
    assert run(monkeypatch, *options) == 2
    said = capsys.readouterr().err
    assert "all frames show the same time; a motion (d-gs)" in said
    got("refused")
    assert not (tmp_path / "f").exists()


def test_a_learned_motion_does_not_replace_that_of_the_scene(monkeypatch, tmp_path, capsys):
    few = ["--views", 4, "--held-out", 1, "--size", 48, 48, "--spp", 1, "--held-out-spp", 2]
    assert run(monkeypatch, "capture", "cloth", tmp_path / "frames", *few) == 0
    options = ["--iterations", 5, "--gaussians", 200, "--layers", 1, "--degree", 0, "--motion", "d-gs"]
    assert run(monkeypatch, "train", tmp_path / "frames", tmp_path / "f", *options) == 0
    assert "does not become the newest one of cloth" in capsys.readouterr().out.replace("\n", " ")
    assert load_forest(tmp_path / "f").motion is not None
    assert newest_forest(as_planned(load_scene("cloth"))) is None
