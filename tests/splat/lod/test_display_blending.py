"""Forests that are blended display-encoded: every layer image is linear radiance before it is composited."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.camera.camera import camera_from_pose
from compose.image.colour import srgb_from_radiance
from splat.io.ply import UNBOUND_FOCAL
from splat.lod import forest_renderer
from splat.lod.forest_renderer import CachedLayerImages, ForestRenderer
from splat.lod.layer_images import LayerImage
from splat.model.forest import Forest, forest_of
from splat.model.gaussians import SH_DC, Blending, perceptual_from_radiance
from splat.model.trees import static_layer
from splat.raster.differentiable import render_differentiable
from tests.splat.lod.views import CORNERS, drawn, everything, frame_camera, no_cutoff, small_forest
from tests.splat.raster.plain_3dgs import picture
from tests.splat.samples import white_dot


def shown(forest: Forest) -> Forest:
    gaussians = replace(forest.nodes.gaussians, blending=Blending.DISPLAY)
    return replace(forest, nodes=replace(forest.nodes, gaussians=gaussians))


def test_the_finest_layer_is_a_picture_of_3d_gaussian_splatting(each_arrays):
    forest, camera = shown(small_forest()), frame_camera()
    image = ForestRenderer(each_arrays, forest).render_layer(camera, 3).numpy()
    expected = picture(forest.finest, camera, 3).clamp(0, 1)
    np.testing.assert_allclose(srgb_from_radiance(image)[::3, ::3], expected, atol=2e-3)
    alone = render_differentiable(each_arrays, forest.finest, camera).numpy()
    np.testing.assert_allclose(image, alone, atol=1e-4)


def test_opacity_stays_as_it_is(arrays):
    forest, camera = shown(small_forest()), frame_camera()
    white = forest.nodes.gaussians.sh.clone().zero_()
    white[0] = 0.5 / SH_DC
    nodes = replace(forest.nodes, gaussians=replace(forest.nodes.gaussians, sh=white))
    image = ForestRenderer(arrays, replace(forest, nodes=nodes)).render_layer(camera, 3)
    samples = image.values.numpy().reshape(-1, image.stride, image.channels)[: camera.height, : camera.width]
    # What is blended of white is the opacity.
    expected = perceptual_from_radiance(image.tensor().torch())[..., 0]
    np.testing.assert_allclose(samples[..., 3], expected, atol=1e-4)


@pytest.mark.parametrize("cached", [False, True])
def test_layers_are_mixed_in_linear_radiance(arrays, cached):
    camera, half = frame_camera(), np.full(CORNERS, 0.5, np.float32)
    renderer = ForestRenderer(arrays, shown(small_forest()))
    if cached:
        mixed = CachedLayerImages(renderer, camera, [(1, 0), (3, 0)]).composite([half, half], everything())
    else:
        mixed = drawn(
            renderer, camera, [LayerImage(1, 0, half), LayerImage(3, 0, half)], no_cutoff(), everything()
        )
    expected = (renderer.render_layer(camera, 1).numpy() + renderer.render_layer(camera, 3).numpy()) / 2
    np.testing.assert_allclose(mixed.numpy(), expected, atol=1e-4)


def test_an_image_drawn_part_by_part_is_the_same(arrays, monkeypatch):
    camera, renderer = frame_camera(), ForestRenderer(arrays, shown(small_forest()))
    whole = renderer.render_layer(camera, 3).numpy()
    monkeypatch.setattr("splat.raster.parts.PAIRS_AT_ONCE", 100)
    monkeypatch.setattr(forest_renderer, "PAIRS_AT_ONCE", 100)
    np.testing.assert_array_equal(renderer.render_layer(camera, 3).numpy(), whole)


def test_lower_rates_filter_no_more_than_they_must(arrays):
    """At 2 x 2 pixels per sample the filter is 0.4 px^2, of which 3D Gaussian splatting has 0.3 already."""
    camera, renderer = frame_camera(), ForestRenderer(arrays, shown(small_forest()))
    found = renderer.render_layer(camera, 3, 1).numpy()
    finest = renderer.forest.finest
    both = [render_differentiable(arrays, finest, camera, variance).numpy() for variance in (0.3, 0.4)]
    # A sample lies in the corner of four pixels, whose mean is another 0.25 px^2 wide.
    means = [(i[::2, ::2] + i[1::2, ::2] + i[::2, 1::2] + i[1::2, 1::2]) / 4 for i in both]
    assert np.abs(found - means[1]).mean() < 0.01 * means[1].mean()


def test_the_dilation_reaches_into_the_frame(arrays):
    """From 1.2 px beyond the border to the first pixels: 0.99 exp(-1.7^2 / 0.6) = 0.008, by twice 1/255."""
    dot, camera = white_dot(4.0, 1e-4, 0.99), camera_from_pose(np.eye(4), 16, 16, 16.0, 16.0, 8.0, 8.5)
    dot.means[0] = -9.2 * 4 / 16
    forest = shown(forest_of([static_layer(dot)], UNBOUND_FOCAL, "", ""))
    image = ForestRenderer(arrays, forest).render_layer(camera, 1).numpy()
    assert srgb_from_radiance(image)[8, 0, 0] == pytest.approx(0.99 * np.exp(-(1.7**2) / 0.6), rel=0.01)
