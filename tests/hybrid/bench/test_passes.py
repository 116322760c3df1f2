"""Passes of frames by mode."""

from __future__ import annotations

from hybrid.bench.passes import bench_passes
from hybrid.frame.settings import FrameSettings
from pathtrace.scene.scene import load_scene
from tests import small
from tests.hybrid.forests import rough_forest


def test_each_mode_has_its_passes(backend):
    scene = load_scene(small.corner())
    settings = FrameSettings(fov_a=30, fov_b=20, spp=1, camera=scene.camera.resized(48, 32))
    rows = bench_passes(scene, rough_forest(scene), settings, 3, 1, lambda done, total: None)
    assert [row["mode"] for row in rows] == ["raw", "denoised", "fused"]
    for row in rows:
        assert list(row["passes"]) == [
            *("region", "detail", "splat", "fill", "trace", "fovea", "blend", "total")
        ]
        parts = sum(times["p50"] for name, times in row["passes"].items() if name != "total")
        assert 0.3 * row["passes"]["total"]["p50"] < parts < 3 * row["passes"]["total"]["p50"]
        assert (row["width"], row["height"], row["repeats"]) == (48, 32, 3)
