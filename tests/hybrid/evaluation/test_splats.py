"""Splats alone as a method among others."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import View
from compose.eye.gaze import Gaze
from hybrid.evaluation.methods import Method, SplatsAlone
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery
from pathtrace.scene.scene import load_scene
from tests import small
from tests.hybrid.forests import rough_forest

pytestmark = pytest.mark.usefixtures("backend")


def test_the_finest_layer_is_shown_at_full_rate_whatever_the_gaze(arrays):
    scene = load_scene(small.corner())
    forest = rough_forest(scene)
    periphery = Periphery(arrays, forest)
    method: Method = SplatsAlone(periphery)
    one, other = (method.render(View(scene.camera), gaze, 0) for gaze in (Gaze(), Gaze(0.1, 0.1)))
    np.testing.assert_array_equal(one.image, other.image)
    finest = FrameSettings(layers=(3, 3))
    np.testing.assert_array_equal(one.image, periphery.whole(scene.camera, finest).numpy())
    coarsest = periphery.whole(scene.camera, FrameSettings(layers=(1, 1))).numpy()
    assert np.abs(one.image - coarsest).max() > 0.05
    assert set(one.milliseconds) == {"splat", "total"}


def test_no_rays_are_traced_and_the_finest_layer_is_counted(arrays):
    scene = load_scene(small.corner())
    forest = rough_forest(scene)
    method = SplatsAlone(Periphery(arrays, forest))
    assert method.rays(scene.camera, Gaze()) == 0
    assert method.settings == {"gaussians": forest.counts[-1]}
    assert forest.counts[-1] == max(forest.counts)
