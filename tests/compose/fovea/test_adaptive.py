"""How many samples each pixel gets."""

from __future__ import annotations

import numpy as np
import pytest

from compose.fovea.adaptive import allotted, disagreement
from tests import small


@pytest.mark.parametrize("total", [1000, 4000, 12345])
def test_samples_fill_up_to_what_each_pixel_is_worth(total):
    rng = small.rng()
    worth = rng.uniform(0.5, 2, 1000).astype(np.float32)
    have = rng.integers(0, 8, 1000).astype(np.float32)
    counts = allotted(worth, have, total, 3)
    assert counts.sum() == total
    assert counts[have == 0].min() >= 1
    # One level for all that get any, and none below it that gets none; whole numbers apart.
    some = counts > 1
    level = np.median((have + counts)[some] / worth[some])
    assert np.abs(have + counts - worth * level)[some].max() < 1.1
    assert (have >= worth * level - 1.1)[counts == 0].all()


def test_equal_pixels_get_equally_many():
    assert (allotted(np.ones(100, np.float32), np.full(100, 3, np.float32), 700, 0) == 7).all()


def test_nothing_gets_nearly_all_or_nearly_nothing():
    worth = np.full(1000, 1e-6, dtype=np.float32)
    worth[:10] = 1e6
    counts = allotted(worth, np.zeros(1000, np.float32), 100_000, 0)
    assert counts.min() > 10
    assert counts.max() < 900


def test_the_dice_do_not_favour_any_pixel():
    """Over many seeds, the mean is what each is due, however small."""
    worth = np.linspace(1, 2, 50).astype(np.float32)
    have = np.full(50, 1, np.float32)
    mean = np.mean([allotted(worth, have, 60, seed) for seed in range(2000)], axis=0)
    due = worth / worth.sum() * 110 - 1
    # A whole number below or above varies by at most a half.
    assert np.abs(mean - due).max() < 4 * 0.5 / np.sqrt(2000)


def test_pictures_that_agree_disagree_nowhere_else():
    picture = small.rng(1).uniform(0, 1, (32, 32, 3)).astype(np.float32)
    other = picture.copy()
    other[10:14, 10:14] = 1 - other[10:14, 10:14]
    found = disagreement(picture, other)
    assert found[12, 12] > 10 * found[25, 25]
    assert found.min() > 0
