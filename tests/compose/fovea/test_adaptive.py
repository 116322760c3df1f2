"""How many samples each pixel gets."""

from __future__ import annotations

import numpy as np
import pytest

from compose.fovea.adaptive import allotted, disagreement
from tests import small


@pytest.mark.parametrize("total", [1000, 4000, 12345])
def test_samples_bring_each_pixel_to_what_it_is_worth(total):
    rng = small.rng()
    worth = rng.uniform(0.5, 2, 1000).astype(np.float32)
    have = rng.integers(0, 8, 1000).astype(np.float32)
    counts = allotted(worth, have, total, 3)
    assert counts.sum() == total
    assert counts[have == 0].min() >= 1
    # One level for all that get any, and those above it get none, but for rounding.
    some = counts > 1
    level = np.median((have + counts)[some] / worth[some])
    assert np.abs(have + counts - worth * level)[some].max() < 1.1
    assert (have >= worth * level - 1.1)[counts == 0].all()


def test_equal_pixels_get_the_same_number():
    assert (allotted(np.ones(100, np.float32), np.full(100, 3, np.float32), 700, 0) == 7).all()


def test_no_pixel_gets_nearly_all_at_once():
    """10 of 1000 pixels are worth a million times the mean: each gets 8 means, the others share the rest."""
    worth = np.full(1000, 1e-6, dtype=np.float32)
    worth[:10] = 1e6
    counts = allotted(worth, np.zeros(1000, np.float32), 100_000, 0)
    np.testing.assert_allclose(counts[:10], 800, atol=1)
    np.testing.assert_allclose(counts[10:], 92_000 / 990, atol=1)


def test_the_worth_of_a_pixel_is_limited():
    """A tenth of the pixels is worth ten means, which count as 5; nothing counts as 0.15.

    Of 100 000 samples these get 5 / (100 * 5 + 900 * 0.15) and 0.15 / (100 * 5 + 900 * 0.15).
    """
    worth = np.zeros(1000, dtype=np.float32)
    worth[::10] = 1
    counts = allotted(worth, np.zeros(1000, np.float32), 100_000, 0)
    np.testing.assert_allclose(counts[::10], 787.4, atol=1.1)
    np.testing.assert_allclose(counts[1::10], 23.6, atol=1.1)


def test_pixels_with_enough_samples_get_none_and_those_without_any_get_one():
    """All samples of 20 go to pixels that have none, though others are worth a thousand times as much."""
    worth = np.ones(30, np.float32)
    worth[10:20] = 1000
    have = np.full(30, 50, np.float32)
    have[:10] = 0
    have[10:20] = 5000
    counts = allotted(worth, have, 20, 0)
    assert (counts[:10] >= 1).all()
    assert counts[10:].sum() == 0
    assert counts.sum() == 20


def test_the_seed_decides_the_rounding():
    worth, have = small.rng().uniform(1, 2, 50).astype(np.float32), np.ones(50, np.float32)
    assert (allotted(worth, have, 60, 5) == allotted(worth, have, 60, 5)).all()
    assert (allotted(worth, have, 60, 5) != allotted(worth, have, 60, 6)).any()


def test_rounding_is_unbiased():
    """Over many seeds the mean is what each pixel is due, however small."""
    worth = np.linspace(1, 2, 50).astype(np.float32)
    have = np.full(50, 1, np.float32)
    mean = np.mean([allotted(worth, have, 60, seed) for seed in range(2000)], axis=0)
    due = worth / worth.sum() * 110 - 1
    # A whole number below or above varies by at most a half.
    assert np.abs(mean - due).max() < 4 * 0.5 / np.sqrt(2000)


def test_further_samples_are_worth_most_where_images_differ():
    picture = small.rng(1).uniform(0, 1, (32, 32, 3)).astype(np.float32)
    other = picture.copy()
    other[10:14, 10:14] = 1 - other[10:14, 10:14]
    found = disagreement(picture, other)
    assert found[12, 12] > 10 * found[25, 25]
    assert found.min() > 0
    assert found.shape == (32, 32)
    # Windows of 5 x 5: the difference reaches 2 pixels further.
    assert (found[8:16, 8:16] > found[25, 25]).all()
    np.testing.assert_allclose(found[7, 7:17], found[25, 25])


def test_the_worth_of_a_pixel_by_hand():
    """(difference + 0.005)^0.8: of equal images, and of black and white."""
    black, white = np.zeros((8, 8, 3), np.float32), np.ones((8, 8, 3), np.float32)
    np.testing.assert_allclose(disagreement(white, white), 0.014427, rtol=1e-4)
    np.testing.assert_allclose(disagreement(white, black), 1.003998, rtol=1e-4)
