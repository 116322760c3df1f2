"""The disc's pixels, weights and tiles."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from compose.fovea.region import Foveation

GAZES = [Gaze(), Gaze(0, 0), Gaze(1, 0.3), Gaze(-0.1, 0.5), Gaze(5, 5)]


def brute_force(foveation: Foveation, width: int, height: int) -> np.ndarray:
    """Weight of every pixel, from the definition."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    radius = np.hypot(x - foveation.gaze.x * width, y - foveation.gaze.y * height)
    a, b = foveation.fov_a / 100 * height, foveation.fov_b / 100 * height
    ramp = np.clip((a - radius) / (a - b), 0, 1) if a > b else (radius < a).astype(float)
    return np.where(radius < a, ramp, 0)


def visible(weight: np.ndarray, tile: int, share: float = 1.0) -> np.ndarray:
    """(rows, columns) whether a tile has a pixel of a lower weight."""
    rows, columns = (-(-side // tile) for side in weight.shape)
    tiles = [
        [(weight[r * tile : (r + 1) * tile, c * tile : (c + 1) * tile] < share).any() for c in range(columns)]
        for r in range(rows)
    ]
    return np.array(tiles)


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize(("fov_a", "fov_b"), [(20, 15), (30, 0), (12, 12), (0, 0), (70, 10)])
def test_weights_follow_the_definition(gaze, fov_a, fov_b):
    foveation = Foveation(gaze, fov_a, fov_b)
    region = foveation.region(61, 40)
    np.testing.assert_allclose(region.weight_image(), brute_force(foveation, 61, 40), atol=1e-6)
    assert (np.diff(region.pixels.astype(np.int64)) > 0).all()
    assert ((region.weights >= 0) & (region.weights <= 1)).all()
    assert region.pixels.dtype == np.uint32
    assert region.weights.dtype == np.float32


def test_weights_by_hand():
    """Radii of 4 and 2 pixels around the middle of a row: pixel centres lie 0.5, 1.5, 2.5 ... pixels away."""
    region = Foveation(Gaze(0.5, 0.5), 400, 200).region(10, 1)
    np.testing.assert_allclose(region.weight_image()[0], [0, 0.25, 0.75, 1, 1, 1, 1, 0.75, 0.25, 0])
    assert region.centre == (5, 0.5)
    assert region.inner == 2


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize(("times", "fov_b"), [(1.201, 0), (1.3, 10)])
def test_a_disc_a_fifth_beyond_the_furthest_pixel_leaves_no_periphery(gaze, times, fov_b):
    """The furthest of 30 x 20 pixels is a corner."""
    whole = Foveation(gaze, times * furthest_of(gaze, 30, 20), fov_b).region(30, 20)
    assert whole.covers_frame
    assert (whole.weight_image() == 1).all()
    assert whole.pixels.tolist() == list(range(600))
    assert not whole.peripheral_tiles(16).any()
    assert whole.foveal_tiles(16).all()


@pytest.mark.parametrize("gaze", GAZES)
def test_fov_b_beyond_the_furthest_pixel_leaves_no_periphery(gaze):
    radius = furthest_of(gaze, 30, 20) + 0.01
    assert Foveation(gaze, radius, radius).region(30, 20).covers_frame
    assert not Foveation(gaze, radius, radius - 0.02).region(30, 20).covers_frame


def furthest_of(gaze: Gaze, width: int, height: int) -> float:
    """Distance of the furthest pixel in percent of the height."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return float(np.hypot(x - gaze.x * width, y - gaze.y * height).max() / height * 100)


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("times", [1.05, 1.1, 1.19])
def test_what_splats_have_left_fades_out_once_the_disc_reaches_all_pixels(gaze, times):
    """A twentieth beyond the furthest pixel they have three quarters of it, a tenth beyond it a half."""
    foveation = Foveation(gaze, times * furthest_of(gaze, 30, 20), 5)
    region = foveation.region(30, 20)
    left = (1 - brute_force(foveation, 30, 20)) * (1.2 - times) / 0.2
    np.testing.assert_allclose(1 - region.weight_image(), left, atol=1e-5)
    assert not region.covers_frame
    assert region.peripheral_tiles(16).any()


def test_without_a_disc_everything_is_periphery():
    region = Foveation(Gaze(), 0, 0).region(30, 20)
    assert not len(region.pixels)
    assert not region.covers_frame
    assert region.peripheral_tiles(16).all()
    assert not region.foveal_tiles(16).any()


@pytest.mark.parametrize("gaze", GAZES)
@pytest.mark.parametrize("tile", [8, 16])
def test_a_tile_is_left_out_only_if_the_disc_hides_all_of_it(gaze, tile):
    region = Foveation(gaze, 60, 45).region(75, 70)
    np.testing.assert_array_equal(region.peripheral_tiles(tile), visible(region.weight_image(), tile))


@pytest.mark.parametrize("gaze", [Gaze(), Gaze(0, 0), Gaze(0.37, 0.61)])
def test_foveal_tiles_overlap_the_rectangle_around_the_disc(gaze):
    region = Foveation(gaze, 25, 10).region(75, 70)
    rows, columns = region.rectangle.box
    outside = np.ones((70, 75))
    outside[rows, columns] = 0
    np.testing.assert_array_equal(region.foveal_tiles(16), visible(outside, 16))


def test_values_become_an_image_of_the_frame():
    region = Foveation(Gaze(0.3, 0.4), 20, 10).region(12, 10)
    values = np.arange(2 * len(region.pixels), dtype=np.float32).reshape(-1, 2) + 1
    image = region.image_of(values)
    assert image.shape == (10, 12, 2)
    np.testing.assert_array_equal(image.reshape(-1, 2)[region.pixels], values)
    assert np.count_nonzero(image) == values.size


@pytest.mark.parametrize(
    ("fov_a", "fov_b", "said"),
    [
        (10, 20, "^fov-b 20: must be at most fov-a 10"),
        (-1, -2, "^fov-a -1: must be a percentage"),
        (1, -2, "^fov-b -2: must be a percentage"),
        (float("nan"), 1, "^fov-a nan: must be a percentage"),
        (20, float("inf"), "^fov-b inf: must be a percentage"),
    ],
)
def test_impossible_radii_are_refused_by_name(fov_a, fov_b, said):
    with pytest.raises(UserError, match=said):
        Foveation(Gaze(), fov_a, fov_b)


def test_default_radii():
    assert (Foveation(Gaze()).fov_a, Foveation(Gaze()).fov_b) == (20, 15)


def test_equal_radii_and_no_disc_are_allowed():
    assert Foveation(Gaze(), 20, 20).fov_b == 20
    assert Foveation(Gaze(), 0, 0).fov_a == 0
