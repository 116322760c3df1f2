"""The composite of periphery and fovea."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.eye.gaze import Gaze
from compose.fovea.disc import Disc, blend
from compose.fovea.foveation import Foveation
from compose.image.device_image import DeviceImage
from tests import small
from tests.compose.arrays_of import channels, disc_of, host, image_on

GAZES = [Gaze(), Gaze(0, 0), Gaze(1, 0.3), Gaze(-0.1, 0.5), Gaze(5, 5)]


def row(arrays: Arrays, weights: list[float]) -> Disc:
    """A disc of one row; pixels with weight 0 do not belong to it."""
    weight = np.array(weights, dtype=np.float32)
    pixels = np.flatnonzero(weight).astype(np.uint32)
    return disc_of(arrays, len(weights), 1, pixels, weight[pixels])


def blended(periphery: np.ndarray, fovea: np.ndarray, disc: Disc) -> np.ndarray:
    """The composite of an image (H, W, 3) and values (D, 3)."""
    arrays = disc.arrays
    composite, behind = blend(image_on(arrays, periphery), channels(arrays, fovea), disc)
    np.testing.assert_array_equal(host(behind), periphery.reshape(-1, 3)[np.array(disc.pixels)])
    return composite.numpy()


def plainly_blended(periphery: np.ndarray, fovea: np.ndarray, disc: Disc) -> np.ndarray:
    """The composite, in plain NumPy."""
    composite = periphery.reshape(-1, 3).astype(np.float64)
    pixels, weight = np.array(disc.pixels), np.array(disc.weights)[:, None].astype(np.float64)
    mixed = composite[pixels] * (1 - weight) + fovea * weight
    composite[pixels] = np.where(weight == 1, fovea, mixed)
    return composite.reshape(periphery.shape)


def test_the_blend_by_hand(arrays):
    """10 + w (20 - 10)."""
    disc = row(arrays, [0, 0.25, 0.5, 1, 0])
    composite = blended(np.full((1, 5, 3), 10, np.float32), np.full((3, 3), 20, np.float32), disc)
    np.testing.assert_allclose(composite[0, :, 0], [10, 12.5, 15, 20, 10])
    assert composite.dtype == np.float32


@pytest.mark.parametrize("gaze", GAZES)
def test_blends_match_a_plain_twin(arrays, gaze):
    """The periphery is a part of a larger buffer, too."""
    rng, disc = small.rng(), Foveation(gaze, 35, 20).region(50, 40).disc(arrays)
    buffer = rng.lognormal(0, 2, (48, 64, 4)).astype(np.float32)
    fovea = rng.lognormal(0, 2, (disc.count, 3)).astype(np.float32)
    expected = plainly_blended(buffer[:40, :50, :3], fovea, disc)
    np.testing.assert_allclose(blended(buffer[:40, :50, :3], fovea, disc), expected, rtol=1e-5)
    values = image_on(arrays, buffer).values
    part = DeviceImage(arrays, values, 50, 40, 64, 4)
    composite, _ = blend(part, channels(arrays, fovea), disc)
    np.testing.assert_allclose(composite.numpy(), expected, rtol=1e-5)
    # Everything beside the image stays.
    buffer[:40, :50, :3] = composite.numpy()
    np.testing.assert_array_equal(composite.values, buffer.ravel())


@pytest.mark.parametrize("gaze", GAZES)
def test_equal_images_blend_to_themselves(arrays, gaze):
    disc = Foveation(gaze, 35, 20).region(50, 50).disc(arrays)
    image = np.random.default_rng(0).uniform(0, 2, (50, 50, 3)).astype(np.float32)
    composite = blended(image, image.reshape(-1, 3)[np.array(disc.pixels)], disc)
    np.testing.assert_allclose(composite, image, rtol=1e-6)


def test_the_composite_takes_the_memory_of_the_periphery_and_nothing_else(arrays):
    region = Foveation(Gaze(), 35, 20).region(50, 50)
    disc, periphery = region.disc(arrays), image_on(arrays, np.ones((50, 50, 3), np.float32))
    kept, fovea = periphery.packed(), channels(arrays, np.zeros((disc.count, 3)))
    composite, behind = blend(periphery, fovea, disc)
    assert composite.values is periphery.values
    assert (kept.numpy() == 1).all()
    assert (host(fovea) == 0).all()
    assert (host(behind) == 1).all()
    np.testing.assert_allclose(composite.numpy()[..., 0], 1 - region.weight_image(), atol=1e-6)


def test_a_disc_that_covers_the_frame_is_exactly_the_traced_frame(arrays):
    disc = Foveation(Gaze(0.3, 0.6), 400, 10).region(30, 20).disc(arrays)
    traced = np.random.default_rng(0).normal(size=(600, 3)).astype(np.float32)
    fovea = channels(arrays, traced)
    composite = blend(image_on(arrays, np.full((20, 30, 3), np.nan)), fovea, disc)[0].numpy().copy()
    assert np.array_equal(composite.reshape(-1, 3), traced)
    assert composite.shape == (20, 30, 3)
    assert (host(fovea) == traced).all()


def test_no_disc_is_exactly_the_splat_frame(arrays):
    disc = Foveation(Gaze(), 0, 0).region(30, 20).disc(arrays)
    splats = np.random.default_rng(0).normal(size=(20, 30, 3)).astype(np.float32)
    assert np.array_equal(blended(splats, np.zeros((0, 3), dtype=np.float32), disc), splats)


def test_at_full_weight_an_infinite_periphery_does_not_show(arrays):
    """0 times infinity is not 0."""
    disc = row(arrays, [1, 0.5, 1, 0])
    periphery = np.array([[[np.inf] * 3, [4.0] * 3, [np.nan] * 3, [1.0] * 3]], dtype=np.float32)
    composite = blended(periphery, np.full((3, 3), 2, np.float32), disc)
    np.testing.assert_allclose(composite[0, :, 0], [2, 3, 2, 1])
