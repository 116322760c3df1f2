"""The composite of periphery and fovea."""

from __future__ import annotations

import numpy as np
import pytest

from compose.blend.blend import blend
from compose.eye.gaze import Gaze
from compose.fovea.region import FoveaRegion, Foveation

GAZES = [Gaze(), Gaze(0, 0), Gaze(1, 0.3), Gaze(-0.1, 0.5), Gaze(5, 5)]


def row(weights: list[float]) -> FoveaRegion:
    """A region of one row; pixels with weight 0 do not belong to it."""
    weight = np.array(weights, dtype=np.float32)
    pixels = np.flatnonzero(weight).astype(np.uint32)
    return FoveaRegion(len(weights), 1, pixels, weight[pixels], (0, 0), 0)


def test_the_blend_by_hand():
    """10 + w (20 - 10)."""
    region = row([0, 0.25, 0.5, 1, 0])
    composite = blend(np.full((1, 5, 3), 10, np.float32), np.full((3, 3), 20, np.float32), region)
    np.testing.assert_allclose(composite[0, :, 0], [10, 12.5, 15, 20, 10])
    assert composite.dtype == np.float32


@pytest.mark.parametrize("gaze", GAZES)
def test_equal_images_blend_to_themselves(gaze):
    region = Foveation(gaze, 35, 20).region(50, 50)
    image = np.random.default_rng(0).uniform(0, 2, (50, 50, 3)).astype(np.float32)
    composite = blend(image, image.reshape(-1, 3)[region.pixels], region)
    np.testing.assert_allclose(composite, image, rtol=1e-6)


def test_the_arguments_are_left_as_they_are():
    region = Foveation(Gaze(), 35, 20).region(50, 50)
    periphery, fovea = np.ones((50, 50, 3), np.float32), np.zeros((len(region.pixels), 3), np.float32)
    composite = blend(periphery, fovea, region)
    assert (periphery == 1).all()
    assert (fovea == 0).all()
    np.testing.assert_allclose(composite[..., 0], 1 - region.weight_image(), atol=1e-6)


def test_a_disc_that_covers_the_frame_is_exactly_the_traced_frame():
    region = Foveation(Gaze(0.3, 0.6), 400, 10).region(30, 20)
    traced = np.random.default_rng(0).normal(size=(600, 3)).astype(np.float32)
    composite = blend(np.full((20, 30, 3), np.nan, dtype=np.float32), traced, region)
    assert np.array_equal(composite.reshape(-1, 3), traced)
    assert composite.shape == (20, 30, 3)
    composite[:] = 0
    assert traced.any()


def test_no_disc_is_exactly_the_splat_frame():
    region = Foveation(Gaze(), 0, 0).region(30, 20)
    splats = np.random.default_rng(0).normal(size=(20, 30, 3)).astype(np.float32)
    assert np.array_equal(blend(splats, np.zeros((0, 3), dtype=np.float32), region), splats)


def test_at_full_weight_an_infinite_periphery_does_not_show():
    """0 times infinity is not 0."""
    region = row([1, 0.5, 1, 0])
    periphery = np.array([[[np.inf] * 3, [4.0] * 3, [np.nan] * 3, [1.0] * 3]], dtype=np.float32)
    composite = blend(periphery, np.full((3, 3), 2, np.float32), region)
    np.testing.assert_allclose(composite[0, :, 0], [2, 3, 2, 1])
