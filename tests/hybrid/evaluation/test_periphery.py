"""The periphery by acuity model."""

from __future__ import annotations

import pytest

from compose.eye.display import Display
from hybrid.evaluation.splat_bench import FULL, GAZES, bench_periphery, display_camera
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from tests import small
from tests.hybrid.forests import rough_forest

DISPLAY = Display(96, 64, 60.0)


def test_full_detail_is_its_own_reference(backend):
    scene = load_scene(small.corner())
    camera = display_camera(scene.camera, DISPLAY)
    assert (camera.width, camera.height) == (96, 64)
    assert camera.position == pytest.approx(scene.camera.position)
    settings = FrameSettings(fov_a=20, fov_b=20, display=DISPLAY)
    rows = bench_periphery(rough_forest(scene), camera, settings, 3, 1, lambda done, total: None)
    full = [row for row in rows if row["acuity_model"] == FULL]
    assert len(full) == len(GAZES)
    assert all(row["ssim"] == pytest.approx(1) and row["ratio"] == 1 for row in full)
    assert all(row["ssim"] <= 1 + 1e-6 for row in rows)
