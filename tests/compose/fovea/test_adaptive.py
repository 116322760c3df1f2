"""How many samples each pixel gets."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from compose.base.traced_samples import Counts
from compose.fovea import adaptive
from compose.fovea.adaptive import window_sum
from compose.image.colour import srgb_from_radiance
from tests import small
from tests.compose.arrays_of import floats


@pytest.mark.parametrize("total", [1000, 4000, 12345])
def test_samples_bring_each_pixel_to_what_it_is_worth(allotted, total):
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


def test_equal_pixels_get_the_same_number(allotted):
    assert (allotted(np.ones(100, np.float32), np.full(100, 3, np.float32), 700, 0) == 7).all()


def test_no_pixel_gets_nearly_all_at_once(allotted):
    """10 of 1000 pixels are worth a million times the mean: each gets 8 means, the others share the rest."""
    worth = np.full(1000, 1e-6, dtype=np.float32)
    worth[:10] = 1e6
    counts = allotted(worth, np.zeros(1000, np.float32), 100_000, 0)
    np.testing.assert_allclose(counts[:10], 800, atol=1)
    np.testing.assert_allclose(counts[10:], 92_000 / 990, atol=1)


def test_the_worth_of_a_pixel_is_limited(allotted):
    """A tenth of the pixels is worth ten means, which count as 5; nothing counts as 0.15.

    Of 100 000 samples these get 5 / (100 * 5 + 900 * 0.15) and 0.15 / (100 * 5 + 900 * 0.15).
    """
    worth = np.zeros(1000, dtype=np.float32)
    worth[::10] = 1
    counts = allotted(worth, np.zeros(1000, np.float32), 100_000, 0)
    np.testing.assert_allclose(counts[::10], 787.4, atol=1.1)
    np.testing.assert_allclose(counts[1::10], 23.6, atol=1.1)


def test_pixels_with_enough_samples_get_none_and_those_without_any_get_one(allotted):
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


def test_the_seed_decides_the_rounding(allotted):
    worth, have = small.rng().uniform(1, 2, 50).astype(np.float32), np.ones(50, np.float32)
    assert (allotted(worth, have, 60, 5) == allotted(worth, have, 60, 5)).all()
    assert (allotted(worth, have, 60, 5) != allotted(worth, have, 60, 6)).any()


def test_rounding_is_unbiased(allotted):
    """Over many seeds the mean is what each pixel is due, however small."""
    worth = np.linspace(1, 2, 50).astype(np.float32)
    have = np.full(50, 1, np.float32)
    mean = np.mean([allotted(worth, have, 60, seed) for seed in range(2000)], axis=0)
    due = worth / worth.sum() * 110 - 1
    # A whole number below or above varies by at most a half.
    assert np.abs(mean - due).max() < 4 * 0.5 / np.sqrt(2000)


def test_further_samples_are_worth_most_where_images_differ(disagreement):
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


def test_the_worth_of_a_pixel_by_hand(disagreement):
    """(difference + 0.005)^0.8: of equal images, and of black and white."""
    black, white = np.zeros((8, 8, 3), np.float32), np.ones((8, 8, 3), np.float32)
    np.testing.assert_allclose(disagreement(white, white), 0.014427, rtol=1e-4)
    np.testing.assert_allclose(disagreement(white, black), 1.003998, rtol=1e-4)


def plainly_allotted(worth: np.ndarray, have: np.ndarray, total: int, seed: int) -> np.ndarray:
    """(D,) further samples in float64, in plain NumPy."""
    known = np.isfinite(worth)
    wide = np.where(known, worth, 0).astype(np.float64)
    relative = np.clip(wide / (wide.sum() / known.sum()), 0.15, 5) if wide.any() else np.ones(len(worth))
    relative = np.where(known, relative, 5)
    have = have.astype(np.float64)
    least, most = (have < 1).astype(np.float64), 8 * total / len(have)
    low, high = 0.0, float((have.max() + most) / relative.min())
    for _ in range(25):
        level = 0.5 * (low + high)
        due = np.clip(relative * level - have, least, most)
        low, high = (level, high) if due.sum() < total else (low, level)
    due = np.clip(relative * 0.5 * (low + high) - have, least, most)
    ends = np.cumsum(due) * (total / due.sum())
    start = np.random.default_rng(seed).random()
    return np.diff(np.floor(np.concatenate([[0.0], ends[:-1], [total]]) + start)).astype(np.int64)


@pytest.mark.parametrize("size", [1, 2, 9, 1000, 50_000])
@pytest.mark.parametrize("spread", [0.0, 0.3, 3.0])
def test_allotments_match_a_plain_twin(allotted, size, spread):
    rng = small.rng(size)
    worth = rng.lognormal(0, spread, size).astype(np.float32)
    worth[rng.random(size) < 0.1] = np.nan
    have = rng.integers(0, 6, size).astype(np.float32)
    total = 3 * size + 1
    counts, expected = allotted(worth, have, total, 4), plainly_allotted(worth, have, total, 4)
    # Sums are rounded in another order, so that one pixel's sample may be its neighbour's.
    assert np.abs(counts - expected).max() <= 1
    assert (counts != expected).mean() < 1e-3


def test_a_number_for_all_is_one_number(arrays):
    ones, zeros = floats(arrays, np.ones(7)), floats(arrays, np.zeros(7))
    assert adaptive.allotted(arrays, ones, zeros, 21, 0) == 3
    assert adaptive.allotted(arrays, ones, zeros, 0, 0) == 0
    assert isinstance(adaptive.allotted(arrays, ones, zeros, 22, 0), Counts)


def test_pixels_that_get_nothing_between_others_do_not_wrap_around(allotted):
    """Sums of parts may fall by a rounding error where nothing is added."""
    rng = small.rng(3)
    for seed in range(20):
        size = int(rng.integers(1000, 200_000))
        have = np.where(rng.random(size) < 0.5, 1e4, 1).astype(np.float32)
        counts = allotted(rng.uniform(0.5, 2, size).astype(np.float32), have, 2 * size, seed)
        assert (counts[have == 1e4] == 0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (3, 4), (32, 40)])
@pytest.mark.parametrize("window", [1, 3, 5, 9])
def test_sums_over_windows_match_a_plain_twin(arrays, shape, window):
    image = small.rng().uniform(0, 2, shape).astype(np.float32)
    found = np.array(window_sum(arrays, floats(arrays, image.ravel()), shape, window)).reshape(shape)
    expected = uniform_filter(image.astype(np.float64), window, mode="nearest") * window**2
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_what_one_pixel_holds_stays_in_the_windows_around_it(arrays):
    """A running sum would carry it on: infinity, and what cancels out of large numbers."""
    for value in (np.inf, np.nan, 1e20):
        image = np.ones((9, 12), dtype=np.float32)
        image[4, 5] = value
        found = np.array(window_sum(arrays, floats(arrays, image.ravel()), image.shape, 5)).reshape(9, 12)
        beside = np.ones_like(found, dtype=bool)
        beside[2:7, 3:8] = False
        np.testing.assert_allclose(found[beside], 25)
        assert not (np.abs(found[~beside] - 25) < 1).any()


@pytest.mark.parametrize("shape", [(1, 1), (3, 7), (40, 31)])
def test_disagreement_matches_a_plain_twin(disagreement, shape):
    rng = small.rng(5)
    denoised, splat = (rng.lognormal(-1, 2, (*shape, 3)).astype(np.float32) for _ in range(2))
    denoised[0, 0, 0], splat[-1, -1] = -1, np.inf
    difference = ((srgb_from_radiance(denoised) - srgb_from_radiance(splat)) ** 2).mean(axis=2)
    mean = uniform_filter(difference.astype(np.float64), 5, mode="nearest")
    np.testing.assert_allclose(disagreement(denoised, splat), (np.sqrt(mean) + 0.005) ** 0.8, rtol=1e-4)
