"""Samples of two passes, and their variance."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from compose.fovea.samples import Samples, averaged_features, merged, put, taken
from tests import small

SIZE = 200


def of_draws(draws: np.ndarray) -> Samples:
    """Samples of D pixels from draws (n, D, 3)."""
    count, size = draws.shape[:2]
    triple = np.full((size, 3), count, dtype=np.float32)
    return Samples(
        np.arange(size, dtype=np.uint32),
        np.full(size, count, dtype=np.float32),
        draws.mean(axis=0),
        (draws**2).mean(axis=0),
        triple,
        triple,
        triple,
        np.full(size, count, dtype=np.uint8),
        np.zeros(size, dtype=np.uint16),
    )


def test_the_variance_is_that_of_the_mean():
    """Two samples, 1 and 3: sample variance 2, of their mean 1."""
    found = of_draws(np.array([[[1, 1, 1]], [[3, 1, 2]]], dtype=np.float32)).variance()
    np.testing.assert_allclose(found, [[1, 0, 0.25]], atol=1e-6)
    assert found.dtype == np.float32


def test_one_sample_does_not_tell_its_variance():
    assert np.isinf(of_draws(np.ones((1, 4, 3), dtype=np.float32)).variance()).all()


def test_rounding_does_not_make_a_negative_variance():
    one = of_draws(np.ones((3, 4, 3), dtype=np.float32))
    assert (replace(one, squares=one.squares * np.float32(0.999)).variance() == 0).all()


def test_merging_is_the_same_as_sampling_at_once():
    draws = small.rng().uniform(0, 2, (8, SIZE, 3)).astype(np.float32)
    whole, both = of_draws(draws), merged(of_draws(draws[:3]), of_draws(draws[3:]))
    for name in ("count", "radiance", "squares"):
        np.testing.assert_allclose(getattr(both, name), getattr(whole, name), rtol=1e-5)
    np.testing.assert_allclose(both.variance(), whole.variance(), rtol=1e-3, atol=1e-5)


def test_everything_but_light_is_the_first_ones():
    one, other = of_draws(np.ones((2, 5, 3), np.float32)), of_draws(np.zeros((3, 5, 3), np.float32))
    both = merged(one, other)
    for field in fields(Samples):
        if field.name not in ("count", "radiance", "squares"):
            assert getattr(both, field.name) is getattr(one, field.name)


def test_pixels_without_samples_take_what_the_other_has():
    one, other = of_draws(np.ones((2, 4, 3), np.float32)), of_draws(np.full((2, 4, 3), 5, np.float32))
    none = replace(one, count=np.array([0, 2, 0, 2], np.float32))
    rest = replace(other, count=np.array([2, 2, 0, 0], np.float32))
    both = merged(none, rest)
    assert both.count.tolist() == [2, 4, 0, 2]
    np.testing.assert_allclose(both.radiance[[0, 1, 3], 0], [5, 3, 1])
    dark = replace(one, count=np.zeros(4, np.float32))
    assert merged(dark, other).radiance is other.radiance
    assert merged(dark, other).squares is other.squares
    assert merged(dark, other).count is other.count


def test_features_are_averaged_by_the_others_share():
    one, other = of_draws(np.ones((2, 3, 3), np.float32)), of_draws(np.ones((6, 3, 3), np.float32))
    found = averaged_features(one, other, np.array([0, 0.25, 1], np.float32))
    for name in ("albedo", "normal"):
        np.testing.assert_allclose(getattr(found, name)[:, 0], [2, 3, 6])
    assert found.position is one.position
    assert found.radiance is one.radiance


def test_some_pixels_are_taken_out_and_put_back():
    one, other = of_draws(np.ones((2, 5, 3), np.float32)), of_draws(np.full((6, 5, 3), 2, np.float32))
    chosen = np.array([4, 1])
    part = taken(other, chosen)
    assert part.pixels.tolist() == [4, 1]
    whole = put(one, chosen, part)
    assert whole.count.tolist() == [2, 6, 2, 2, 6]
    assert whole.gloss.tolist() == [2, 6, 2, 2, 6]
    assert whole.pixels.tolist() == one.pixels.tolist()
    assert one.count.tolist() == [2] * 5
