"""What each decision of a plan gains and loses."""

from __future__ import annotations

from dataclasses import replace

import pytest

from compose.eye.display import DISPLAYS
from hybrid.bench.choices import FIXED, PLANNED, Choices
from hybrid.bench.plan import Effort, bench_plan
from hybrid.frame.settings import FrameSettings
from hybrid.plan.plan import plan_of
from hybrid.runtime.device import device_arrays
from hybrid.runtime.progress import no_bars
from pathtrace.scene.scene import load_scene
from splat.io.precision import Precision
from tests import small

SIZE = (64, 64)
EFFORT = Effort(iterations=24, views=18, side=32, judged=1, reference_spp=8, repeats=3)


def test_items_that_are_as_if_fixed_have_no_row():
    choices = replace(Choices(), degree=0, precision=Precision.COMPACT)
    rows = choices.rows()
    assert list(rows) == [FIXED, "degree", "precision", PLANNED]
    assert rows["degree"] == replace(Choices(), degree=0)
    assert rows[PLANNED] == choices
    assert (choices.value("degree"), choices.value("precision")) == (0, "compact")
    assert list(Choices().rows()) == [FIXED, PLANNED]


def test_each_decision_has_a_row(backend, own_home, tmp_path):
    scene = load_scene(small.corner())
    plan = plan_of(scene, DISPLAYS["desktop"], SIZE)
    settings = FrameSettings(camera=scene.camera.resized(*SIZE))
    # Frames of 32 pixels are too small for four layers.
    few = replace(Choices.planned(plan), path_depth=4, layers=2, gaussians=300)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Choices, "planned", staticmethod(lambda plan: few))
        patch.setattr(Choices, "training", _tiny(Choices.training))
        bench = scene, plan, settings, EFFORT, tmp_path, device_arrays().backend, no_bars
        rows = bench_plan(*bench)
        names = [row["decision"] for row in rows]
        assert names[0] == FIXED
        assert names[-1] == PLANNED
        assert {"path depth", "degree", "harmonics", "gaussians", "precision"} < set(names)
        by_name = dict(zip(names, rows, strict=True))
        fixed, planned = by_name[FIXED], by_name[PLANNED]
        assert planned["file_bytes"] < fixed["file_bytes"] / 4
        assert by_name["precision"]["file_bytes"] < fixed["file_bytes"]
        assert (fixed["bias"], by_name["path depth"]["fixed"]) == (0, -1)
        assert 0 < planned["bias"] < 0.1
        for row in rows:
            assert min(row["psnr"], row["foveal_psnr"]) > 5
            assert 0 < row["ssim"] <= 1
            assert row["frame_ms"]["p95"] >= row["frame_ms"]["p50"] > 0
            assert row["training_mib"] > 0
        # What was trained is not trained again.
        again = bench_plan(*bench)
        assert [row["seconds"] for row in again] == [row["seconds"] for row in rows]


def _tiny(training):
    """At most two layers, and few Gaussians."""

    def tiny(self, iterations, seed):
        found = training(self, iterations, seed)
        return replace(found, layers=min(found.layers, 2), gaussians=min(found.gaussians, 400))

    return tiny
