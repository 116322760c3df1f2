"""All ways to make a fovea, compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hybrid.bench.candidates import Candidates, whole_underlay
from hybrid.bench.change import bench_change
from hybrid.bench.fusion import FusionEffort, bench_fusion
from hybrid.frame.periphery import Periphery
from hybrid.plan.stored import planned_scene
from pathtrace.dataset.frames import read_frame_set
from pathtrace.fill.fill import fill_cache
from splat.io.forest_file import load_forest


def test_candidates_cover_the_frame(made: Path, arrays):
    scene, forest = planned_scene("cornell"), load_forest(made / "box.forest")
    camera = scene.camera.resized(32, 24)
    cache = fill_cache(scene, [camera], points=4096)
    images = Candidates(arrays, scene, forest, cache).images(camera, 1, 0)
    assert {image.shape for image in images.values()} == {(24, 32, 3)}
    underlay = whole_underlay(Periphery(arrays, forest), camera)
    np.testing.assert_array_equal(images["splat"], underlay.radiance.numpy())
    assert not np.array_equal(images["denoised"], images["denoised, path"])
    np.testing.assert_allclose(images["mean"], (images["denoised"] + images["splat"]) / 2, atol=1e-6)


def test_effort_decides_on_the_rows(made: Path, arrays):
    scene, frames = planned_scene("cornell"), read_frame_set(made / "frames")
    forest, effort = load_forest(made / "box.forest"), FusionEffort((1,), (1,), 1, 4)
    rows = bench_fusion(scene, frames, forest, effort, lambda done, total: None)
    assert {(row["scale"], row["spp"], row["seeds"]) for row in rows} == {(1, 1, 1)}
    changed = bench_change(lambda: planned_scene("cornell"), frames, forest, 1, 4, lambda done, total: None)
    assert {row["change"] for row in changed} == {"object moved", "texture swapped", "lamp dimmed"}
