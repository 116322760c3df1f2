"""The disc's pixels, weights and tiles."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.gaze import Gaze
from compose.fovea.foveation import FoveaMode, FoveaRegion, Foveation
from tests import small
from tests.compose.arrays_of import channels

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
    weights = region.weight_image()
    assert ((weights >= 0) & (weights <= 1)).all()
    assert region.pixels.dtype == np.uint32
    assert weights.dtype == np.float32


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
    assert region.count == 0
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
    rows, columns = region.box
    outside = np.ones((70, 75))
    outside[rows, columns] = 0
    np.testing.assert_array_equal(region.foveal_tiles(16), visible(outside, 16))


def test_values_become_an_image_of_the_frame(arrays):
    disc = Foveation(Gaze(0.3, 0.4), 20, 10).region(12, 10).disc(arrays)
    values = np.arange(2 * disc.count, dtype=np.float32).reshape(-1, 2) + 1
    image = disc.frame_image(channels(arrays, values))
    assert image.shape == (10, 12, 2)
    np.testing.assert_array_equal(image.reshape(-1, 2)[np.array(disc.pixels)], values)
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


def assert_same_on_device(arrays, region: FoveaRegion) -> None:
    """The disc on the device has the region's pixels, weights and box."""
    disc, image = region.disc(arrays), region.weight_image()
    pixels = np.array(disc.pixels)
    assert (disc.width, disc.height) == (region.width, region.height)
    assert disc.count == region.count == len(region.pixels)
    np.testing.assert_array_equal(pixels, region.pixels)
    # A radius is known up to a few of its last digits; thin bands magnify that.
    reach = np.spacing(np.float32(max(region.outer, region.width, *map(abs, region.centre))))
    atol = 1e-6 + 3 * reach * min(1 / max(region.outer - region.inner, 1e-6), 1e3)
    np.testing.assert_allclose(np.array(disc.weights), image.ravel()[pixels], atol=atol)
    np.testing.assert_allclose(disc.frame_image([disc.weights])[..., 0], image, atol=atol)
    assert disc.covers_frame == region.covers_frame
    assert (disc.box is None) == (disc.count == 0)
    if disc.count:
        assert disc.box == region.box
        row, column = np.divmod(pixels.astype(np.int64), region.width)
        for at, side, size in zip((row, column), disc.box, (region.height, region.width), strict=True):
            assert 0 <= side.start <= at.min()
            assert at.max() < side.stop <= size
            # One more at most, for an even side.
            assert side.stop - side.start - (at.max() + 1 - at.min()) in (0, 1)


@pytest.mark.parametrize("gaze", [*GAZES, Gaze(1, 1), Gaze(0.5, 1.2), Gaze(0.31, 0.77)])
@pytest.mark.parametrize("size", [(64, 48), (61, 40), (1, 1), (1, 90), (90, 1), (7, 5), (300, 200)])
def test_the_disc_on_the_device_is_that_of_the_host(arrays, gaze, size):
    """With a band and without one, empty, cut by the frame, fading out, and beyond all of the frame."""
    radii = [(20, 15), (30, 0), (12, 12), (0, 0), (0.01, 0), (70, 10), (110, 5), (500, 10), (100, 100)]
    for radius in radii:
        assert_same_on_device(arrays, Foveation(gaze, *radius).region(*size))


def test_random_discs_on_the_device_are_those_of_the_host(arrays):
    rng = small.rng(7)
    for _ in range(100):
        fov_a = float(rng.uniform(0, 150) ** rng.choice([0.5, 1]))
        foveation = Foveation(Gaze(*rng.uniform(-0.5, 1.5, 2)), fov_a, fov_a * float(rng.uniform()))
        assert_same_on_device(arrays, foveation.region(*rng.integers(1, 150, 2).tolist()))


@pytest.mark.parametrize("gaze", GAZES[:3])
def test_a_disc_of_a_large_frame_on_the_device(arrays, gaze):
    """So many rows that their table is one of the larger ones."""
    assert_same_on_device(arrays, Foveation(gaze, 45, 44).region(1000, 2100))


def test_no_kernel_is_compiled_for_another_gaze(arrays):
    def looked(x: float) -> None:
        disc = Foveation(Gaze(x, 0.4), 20, 10).region(200, 100).disc(arrays)
        dr.eval(disc.pixels, disc.weights, disc.inside)

    looked(0.3)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        looked(0.61)
        kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(entry["cache_hit"] for entry in kernels)


def test_modes_have_the_names_that_settings_and_files_use():
    assert [FoveaMode(name) for name in ("raw", "denoised", "fused")] == list(FoveaMode)
