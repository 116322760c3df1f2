"""Guided directions: densities, and means that stay what they are without a guide."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.fill.filling import Guide, even_squares
from tests import small

REGIONS, RAYS = 40, 200


def light(square: np.ndarray) -> np.ndarray:
    """Light from a few directions: half of a bin, 1 / 128 of all of them."""
    return np.where((square[:, 0] < 1 / 16) & (square[:, 1] < 1 / 8), 128.0, 0.0).astype(np.float32)


def region_of_rays() -> np.ndarray:
    return np.repeat(np.arange(REGIONS), RAYS)


def test_even_directions_have_one_ray_of_each_point_in_each_stratum():
    square = even_squares(5000, 2, small.rng())
    assert square.dtype == np.float32
    assert ((square >= 0) & (square < 1)).all()
    np.testing.assert_array_equal((2 * square[:, 0]).astype(int), np.tile([0, 1], 5000))
    np.testing.assert_allclose(square.mean(axis=0), 0.5, atol=0.02)


def test_half_of_the_guided_rays_go_where_light_came_from():
    region = np.repeat([0, 1], 4000)
    square = even_squares(4000, 2, small.rng())
    # The second region is dark.
    guide = Guide(region, square, np.where(region == 0, light(square), 0))
    found = guide.squares(region, small.rng(1))
    assert ((found >= 0) & (found < 1)).all()
    assert found.dtype == np.float32
    bright = (found < 1 / 8).all(axis=1)
    assert bright[region == 0].mean() == pytest.approx(0.5 + 0.5 / 64, abs=0.03)
    assert bright[region == 1].mean() == pytest.approx(1 / 64, abs=0.01)
    # Within a bin and outside of it, directions are even.
    np.testing.assert_allclose(8 * found[bright].mean(axis=0), 0.5, atol=0.03)
    np.testing.assert_allclose(found[region == 1].mean(axis=0), 0.5, atol=0.02)


def test_weights_are_those_of_the_balance_heuristic():
    region, square = np.zeros(3, dtype=np.int64), np.float32([[0.05, 0.05], [0.3, 0.9], [0.9, 0.9]])
    guide = Guide(region, square, np.float32([3, 1, 0]))
    expected = [2 / (1.5 + 0.5 * 64 * share) for share in (0.75, 0.25, 0)]
    np.testing.assert_allclose(guide.weights(region, square), expected, rtol=1e-6)
    # Each ray as if it had brought nothing.
    brought = np.float32([3, 1, 0])
    expected = [2 / 1.5, 2 / 1.5, 2 / 1.5]
    np.testing.assert_allclose(guide.weights(region, square, brought), expected, rtol=1e-6)


def test_a_ray_alone_with_its_light_has_the_weight_of_an_even_one():
    region, square, brought = np.zeros(1, dtype=np.int64), np.float32([[0.5, 0.5]]), np.float32([0.1])
    np.testing.assert_allclose(Guide(region, square, brought).weights(region, square, brought), 1)


def estimates(seed: int) -> np.ndarray:
    """Mean light of each region by even and guided rays; it is 1."""
    random, region = small.rng(seed), region_of_rays()
    even = even_squares(REGIONS * RAYS, 1, random)
    brought = light(even)
    guide = Guide(region, even, brought)
    guided = guide.squares(region, random)
    parts = guide.weights(region, even, brought) * brought + guide.weights(region, guided) * light(guided)
    return np.bincount(region, parts) / (2 * RAYS)


def test_means_stay_what_they_are_and_noise_falls():
    """Were rays weighed by what they brought themselves, a tenth of the light would be missing."""
    found = np.concatenate([estimates(seed) for seed in range(100)])
    error = found.std() / np.sqrt(len(found))
    assert error < 0.01
    assert found.mean() == pytest.approx(1, abs=4 * float(error) + 0.02)
    # As many even rays: a share of 1 / 128 finds a light of 128.
    assert found.std() < 0.75 * np.sqrt(127 / (2 * RAYS))


def test_without_rays_there_is_no_guide():
    nothing = np.zeros(0, dtype=np.int64)
    guide = Guide(nothing, np.zeros((0, 2), np.float32), np.zeros(0, np.float32))
    assert guide.squares(nothing, small.rng()).shape == (0, 2)
    assert guide.weights(nothing, np.zeros((0, 2), np.float32)).shape == (0,)
