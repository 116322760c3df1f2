"""Disc, weights, tiles, and the blend."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.blend.blend import blend
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation
from compose.image.colour import bytes_from_radiance

GAZES = [Gaze(), Gaze(0, 0), Gaze(1, 0.3), Gaze(-0.1, 0.5), Gaze(5, 5)]


def brute_force(foveation: Foveation, width: int, height: int) -> np.ndarray:
    """Weight of every pixel, from the definition."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    radius = np.hypot(x - foveation.gaze.x * width, y - foveation.gaze.y * height)
    a, b = foveation.fov_a / 100 * height, foveation.fov_b / 100 * height
    ramp = np.clip((a - radius) / (a - b), 0, 1) if a > b else (radius < a).astype(float)
    return np.where(radius < a, ramp, 0)


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize(("fov_a", "fov_b"), [(20, 15), (30, 0), (12, 12), (0, 0), (70, 10)])
def test_weights_follow_the_definition(gaze, fov_a, fov_b):
    foveation = Foveation(gaze, fov_a, fov_b)
    region = foveation.region(61, 40)
    np.testing.assert_allclose(region.weight_image(), brute_force(foveation, 61, 40), atol=1e-6)
    assert len(np.unique(region.pixels)) == len(region.pixels)
    assert ((region.weights >= 0) & (region.weights <= 1)).all()


@pytest.mark.parametrize("gaze", GAZES)
def test_the_two_shares_sum_to_one(gaze):
    """Where both pictures are the same, the composite is that picture."""
    region = Foveation(gaze, 35, 20).region(50, 50)
    image = np.full((50, 50, 3), 0.7, dtype=np.float32)
    composite = blend(image, image.reshape(-1, 3)[region.pixels], region)
    np.testing.assert_allclose(composite, image, atol=1e-6)


def test_a_disc_that_covers_the_frame_is_the_traced_frame_exactly():
    region = Foveation(Gaze(0.3, 0.6), 400, 10).region(30, 20)
    traced = np.random.default_rng(0).normal(size=(600, 3)).astype(np.float32)
    composite = blend(np.full((20, 30, 3), np.nan, dtype=np.float32), traced, region)
    assert np.array_equal(composite.reshape(-1, 3)[region.pixels], traced)
    assert not region.peripheral_tiles(16).any()


def test_no_disc_is_the_splat_frame_exactly():
    region = Foveation(Gaze(), 0, 0).region(30, 20)
    splats = np.random.default_rng(0).normal(size=(20, 30, 3)).astype(np.float32)
    assert np.array_equal(blend(splats, np.zeros((0, 3), dtype=np.float32), region), splats)
    assert region.peripheral_tiles(16).all()


@pytest.mark.parametrize("gaze", GAZES)
def test_a_tile_is_left_out_only_where_the_disc_hides_all_of_it(gaze):
    region = Foveation(gaze, 60, 45).region(75, 70)
    tiles = region.peripheral_tiles(16)
    weight = region.weight_image()
    for row in range(tiles.shape[0]):
        for column in range(tiles.shape[1]):
            box = weight[row * 16 : row * 16 + 16, column * 16 : column * 16 + 16]
            assert tiles[row, column] == bool((box < 1).any())


@pytest.mark.parametrize(("fov_a", "fov_b"), [(10, 20), (-1, -2), (float("nan"), 1), (20, float("inf"))])
def test_impossible_radii_are_refused(fov_a, fov_b):
    with pytest.raises(UserError, match="--fov-"):
        Foveation(Gaze(), fov_a, fov_b)


def test_bytes_are_srgb():
    """Half of the light is 188 of 255."""
    values = np.array([[[0.0, 0.5, 1.0], [-1.0, 2.0, 0.0031308]]], dtype=np.float32)
    assert bytes_from_radiance(values).tolist() == [[[0, 188, 255], [0, 255, 10]]]
