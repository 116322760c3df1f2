"""Nodes that move, told from those that stand still, with masks and without."""

from __future__ import annotations

import pytest

from compose.base.errors import UserError
from hybrid.bench.separation import bench_separation
from pathtrace.dataset.capture import capture
from pathtrace.dataset.settings import CaptureSettings
from pathtrace.scene.scene import load_scene
from splat.model.motion_model import Labels, MotionModel
from splat.training.trainer import TrainingSettings
from tests import small
from tests.hybrid.command import run
from tests.moving import moving_corner

SETTINGS = TrainingSettings(30, 400, layers=2, degree=0)


def silent(done: int, total: int) -> None:
    pass


def test_both_kinds_of_labels_have_a_row(backend, tmp_path):
    scene = moving_corner(tmp_path)
    frames = capture(scene, tmp_path / "frames", CaptureSettings(16, 0, 32, 32, spp=2), silent)
    done = []
    known, masks, flow = bench_separation(scene, frames, SETTINGS, lambda *now: done.append(now))
    assert [row["motion"] for row in (known, masks, flow)] == ["known", "d-gs-dynamic", "d-gs-dynamic"]
    assert [row["labels"] for row in (known, masks, flow)] == ["masks", "masks", "flow"]
    for row in (known, masks):
        assert row["pixel_precision"] == row["pixel_recall"] == 1
        assert row["objects"] == 1
    assert min(known["precision"], known["recall"]) > 0.9
    assert min(flow["pixel_precision"], flow["pixel_recall"]) > 0.6
    assert min(masks["precision"], masks["recall"], flow["precision"], flow["recall"]) > 0.6
    assert done[-1] == (90, 90)


def test_a_scene_that_stands_still_is_refused(backend, tmp_path, monkeypatch, capsys):
    with pytest.raises(UserError, match="nothing moves in this scene"):
        bench_separation(load_scene(small.corner()), None, SETTINGS, silent)
    assert run(monkeypatch, "bench", "separation", "cornell", "--json", tmp_path / "f.json") == 2
    assert capsys.readouterr().err.strip().endswith("nothing moves in this scene")
    assert not (tmp_path / "f.json").exists()


@pytest.mark.parametrize("motion", [MotionModel.KNOWN, MotionModel.D_GS, MotionModel.HEX_PLANE])
def test_flow_labels_are_for_a_motion_that_needs_them(motion):
    with pytest.raises(ValueError, match=f"labels flow with motion {motion.value}"):
        TrainingSettings(motion=motion, labels=Labels.FLOW)
