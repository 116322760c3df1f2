"""Benches of the rasterizer and of the periphery."""

from __future__ import annotations

import numpy as np
import pytest

from compose.eye.display import Display
from hybrid.evaluation.splat_bench import (
    FULL,
    GAZES,
    bench_periphery,
    bench_raster,
    display_camera,
    random_splats,
)
from hybrid.render.frame_settings import FrameSettings
from pathtrace.scene.scene import load_scene
from tests import small
from tests.hybrid.forests import rough_forest
from tests.splat.raster.splats import inverse_covariance


def test_splats_lie_in_the_frame_with_positive_definite_shapes(arrays):
    splats = random_splats(arrays, 500, 40, 30, np.random.default_rng(0))
    x, y, opacity = (getattr(splats, name).numpy() for name in ("x", "y", "opacity"))
    xx, xy, yy = inverse_covariance(splats).values()
    assert (x >= 0).all()
    assert (x <= 40).all()
    assert 0 <= y.min() < 1 < 29 < y.max() <= 30
    assert (xx * yy - xy**2 > 0).all()
    # No standard deviation is below half a pixel: no eigenvalue of the inverse covariance is above 4.
    assert ((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)).max() < 4.01
    assert (opacity > 0.049).all()
    assert (opacity < 0.991).all()


def test_a_round_is_counted_and_the_same_seed_has_the_same_pairs(arrays):
    done = []
    rows = [bench_raster(200, (48, 32), 1, 3, 1, lambda n, total: done.append((n, total))) for _ in range(2)]
    assert done == 2 * [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert rows[0]["pairs"] == rows[1]["pairs"] > 200
    assert rows[0]["forward_ms"]["p50"] > 0


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
