"""The seam between fovea and periphery."""

from __future__ import annotations

from pathlib import Path

from hybrid.bench.seam import bench_seam
from hybrid.frame.settings import FrameSettings
from hybrid.plan.stored import planned_scene
from pathtrace.dataset.frames import read_frame_set
from splat.io.forest_file import load_forest


def test_there_is_a_row_per_mode(made: Path, backend):
    scene, frames = planned_scene("cornell"), read_frame_set(made / "frames")
    settings = FrameSettings(fov_a=30, fov_b=15, spp=1)
    rows = bench_seam(scene, frames, load_forest(made / "box.forest"), settings, 4, lambda done, total: None)
    assert [row["mode"] for row in rows] == ["raw", "denoised", "fused"]
    # Single sectors differ at least as much as the whole band.
    assert all(row["sectors"] >= abs(row["difference"]) for row in rows)
