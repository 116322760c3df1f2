"""Cached layer images make the same frames as fresh ones."""

from __future__ import annotations

import numpy as np

from splat.lod.forest_renderer import CachedLayerImages, ForestRenderer
from splat.lod.layer_images import LayerImage
from splat.model.forest import forest_of
from splat.model.trees import static_layer
from tests.splat.lod.views import CELLS, drawn, everything, frame_camera, no_cutoff, ramp, small_forest
from tests.splat.samples import gaussians

STEPS = [(3, 0), (2, 1), (1, 2)]
RISING = ramp(0, 0.4)
WEIGHTS = [RISING, ramp(0.2, 0.2), 1 - RISING - ramp(0.2, 0.2)]


def test_a_cached_frame_equals_a_fresh_one(arrays):
    renderer, camera = ForestRenderer(arrays, small_forest()), frame_camera()
    cached = CachedLayerImages(renderer, camera, STEPS)
    # More than once, and with other weights in between.
    for weights in (WEIGHTS, WEIGHTS[::-1], WEIGHTS):
        images = [LayerImage(*step, weight) for step, weight in zip(STEPS, weights, strict=True)]
        fresh = drawn(renderer, camera, images, no_cutoff(), everything())
        frame = cached.composite(weights, everything())
        np.testing.assert_allclose(frame.numpy(), fresh.numpy(), atol=1e-5)
        assert frame.nodes == fresh.nodes


def test_only_wanted_cells_are_composited(arrays):
    cached = CachedLayerImages(ForestRenderer(arrays, small_forest()), frame_camera(), STEPS)
    wanted = everything()
    wanted[:, 4:] = False
    whole, part = cached.composite(WEIGHTS, everything()).numpy(), cached.composite(WEIGHTS, wanted).numpy()
    np.testing.assert_array_equal(part[:, :64], whole[:, :64])
    assert (part[:, 64:] == 0).all()
    assert (whole[:, 64:] != 0).any()


def test_images_without_a_weight_are_left_out(arrays):
    cached = CachedLayerImages(ForestRenderer(arrays, small_forest()), frame_camera(), STEPS)
    none, full = ramp(0, 0), ramp(1, 1)
    alone = CachedLayerImages(ForestRenderer(arrays, small_forest()), frame_camera(), [STEPS[1]])
    first, second = cached.composite([none, full, none], everything()), alone.composite([full], everything())
    # Up to rounding: the image lies elsewhere in its atlas.
    np.testing.assert_allclose(first.numpy(), second.numpy(), atol=1e-5)
    black = cached.composite([none] * 3, everything())
    assert (black.numpy() == 0).all()
    assert black.numpy().shape == (100, 150, 3)
    assert (cached.composite(WEIGHTS, np.zeros(CELLS, dtype=bool)).numpy() == 0).all()


def test_a_view_of_nothing_is_black(arrays):
    g = gaussians(n=5, degree=0)
    g.means[2] -= 100
    renderer = ForestRenderer(arrays, forest_of([static_layer(g)], 120.0, "", ""))
    frame = CachedLayerImages(renderer, frame_camera(), [(1, 0)]).composite([ramp(1, 1)], everything())
    assert frame.nodes == 0
    assert (frame.numpy() == 0).all()
