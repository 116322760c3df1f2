"""Random splats for the rasterizer's bench, and its row."""

from __future__ import annotations

import numpy as np

from hybrid.evaluation.splat_bench import bench_raster, random_splats
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
