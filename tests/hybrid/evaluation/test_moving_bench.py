"""Methods that show a scene that plays, by region."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from hybrid.evaluation import equal_cost
from hybrid.evaluation import moving_bench as module
from hybrid.evaluation.moving_bench import ALONE, HYBRID, SPLATS, TRACED, bench_moving
from hybrid.render.frame_settings import INTERACTIVE
from pathtrace.scene.scene import load_scene
from pathtrace.trace.film import frame_positions
from pathtrace.trace.tracer import Tracer
from tests import small
from tests.hybrid.forests import rough_forest
from tests.moving import moving_corner


def silent(done: int, total: int) -> None:
    pass


@pytest.fixture(scope="module")
def forest(backend, tmp_path_factory):
    return rough_forest(moving_corner(tmp_path_factory.mktemp("forest")))


@pytest.fixture(scope="module")
def found(backend, forest, tmp_path_factory):
    """Rows by method and region; the forest competes with itself under another name."""
    scene = moving_corner(tmp_path_factory.mktemp("scene"))
    settings = replace(INTERACTIVE, camera=scene.camera.resized(64, 48))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_CLIPS", 2)
        # As many as tell what has been uncovered.
        patch.setattr(module, "_FRAMES", 5)
        # A frame takes as long as ours, whatever this machine does meanwhile.
        patch.setattr(equal_cost, "_ENDURED", {1: 1e9})
        patch.setattr(equal_cost, "TOLERANCE", 1e9)
        rows = bench_moving(scene, forest, settings, 16, silent, {"again": forest})
    return {(row["method"], row["region"]): row for row in rows}


def test_every_method_has_a_row_for_each_region(found):
    names = {region for _, region in found}
    assert {"whole", "foveal", "salient", "moving", "uncovered"} <= names
    assert {method for method, _ in found} >= {HYBRID, ALONE, SPLATS, TRACED}
    assert set(found) == {(method, name) for method, _ in found for name in names}
    assert "registration_px" in found[HYBRID, "moving"]
    assert found[HYBRID, "whole"]["ratio"] == 1
    assert found[HYBRID, "whole"]["pixels"] == 2 * 64 * 48
    assert all(0 < row["ms"]["p50"] <= row["ms"]["p95"] for row in found.values())
    # The disc is traced; rough splats are far from the truth.
    assert found[HYBRID, "foveal"]["psnr"] > found[SPLATS, "foveal"]["psnr"] + 3


def test_other_forests_are_drawn_as_splats_alone(found, forest):
    """The same forest under another name has the same rows; of layers, those by acuity are drawn, too."""
    for region in ("whole", "foveal", "moving"):
        assert found["again", region]["psnr"] == found[SPLATS, region]["psnr"]
    layered = len(forest.counts) > 1
    assert (("again, fov-gs", "whole") in found) == layered
    assert (("again, stelacsf", "whole") in found) == layered
    assert found["again", "whole"].get("jod") == found[SPLATS, "whole"].get("jod")


def test_regions_are_what_moves_and_what_it_leaves(backend, tmp_path):
    """The board goes aside."""
    scene = moving_corner(tmp_path)
    camera = scene.camera.resized(64, 48)
    clip = module._clip(Tracer(scene), scene.moving, camera, 2, 16)
    assert list(clip.times) == sorted(clip.times)
    assert scene.moving.time == clip.times[-1]
    board = Tracer(scene).hits(camera, frame_positions(camera)).shape.reshape(48, 64)
    numbers = np.unique(board[clip.masks["moving"]])
    assert len(numbers) == 1
    np.testing.assert_array_equal(board == numbers[0], clip.masks["moving"])
    assert clip.masks["uncovered"].any()
    assert not (clip.masks["uncovered"] & clip.masks["moving"]).any()
    assert not (clip.masks["shadow"] & (clip.masks["moving"] | clip.masks["uncovered"])).any()
    scene.moving.set_time(clip.times[-2])
    before = Tracer(scene).hits(camera, frame_positions(camera)).shape.reshape(48, 64) == numbers[0]
    masks = before, clip.masks["uncovered"], clip.masks["moving"]
    was, left, now = (np.nonzero(mask)[1].mean() for mask in masks)
    # What it has left lies where it came from.
    assert (left - now) * (was - now) > 0
    row, column = int(clip.gaze.y * 48), int(clip.gaze.x * 64)
    assert clip.masks["moving"][row, column]


def test_where_nothing_is_seen_to_move_the_gaze_rests_on_the_centre():
    assert module._gaze_on(np.zeros((4, 6), dtype=bool)) == Gaze()


def test_a_scene_that_stands_still_is_refused(backend):
    with pytest.raises(UserError, match="nothing moves in this scene"):
        module.require_moving(load_scene(small.corner()))
