"""Samples of two passes, and their variance."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.fovea.samples import Samples, averaged_features, merged, put, taken
from tests import small
from tests.compose.arrays_of import PlainSamples, floats, indices, numbers

SIZE = 200


def of_draws(arrays: Arrays, draws: np.ndarray) -> Samples:
    """Samples of D pixels from draws (n, D, 3)."""
    count, size = draws.shape[:2]
    triple = np.full((size, 3), count, dtype=np.float32)
    return PlainSamples(
        np.arange(size, dtype=np.uint32),
        np.full(size, count, dtype=np.float32),
        draws.mean(axis=0),
        (draws**2).mean(axis=0),
        triple,
        triple,
        triple,
        np.full(size, count, dtype=np.uint8),
        np.zeros(size, dtype=np.uint16),
        np.zeros(size, dtype=np.float32),
    ).on(arrays)


def uniform(arrays: Arrays, count: int, size: int, value: float = 1.0) -> Samples:
    """So many draws of one value."""
    return of_draws(arrays, np.full((count, size, 3), value, dtype=np.float32))


def test_the_variance_is_that_of_the_mean(arrays):
    """Two samples, 1 and 3: sample variance 2, of their mean 1."""
    found = numbers(of_draws(arrays, np.array([[[1, 1, 1]], [[3, 1, 2]]], dtype=np.float32)), "variance")
    np.testing.assert_allclose(found, [[1, 0, 0.25]], atol=1e-6)
    assert found.dtype == np.float32


def test_one_sample_does_not_tell_its_variance(arrays):
    assert np.isinf(numbers(uniform(arrays, 1, 4), "variance")).all()


def test_rounding_does_not_make_a_negative_variance(arrays):
    one = uniform(arrays, 3, 4)
    less = replace(one, squares=[channel * 0.999 for channel in one.squares])
    assert (numbers(less, "variance") == 0).all()


def test_merging_is_the_same_as_sampling_at_once(arrays):
    draws = small.rng().uniform(0, 2, (8, SIZE, 3)).astype(np.float32)
    whole = of_draws(arrays, draws)
    both = merged(of_draws(arrays, draws[:3]), of_draws(arrays, draws[3:]))
    for name in ("count", "radiance", "squares"):
        np.testing.assert_allclose(numbers(both, name), numbers(whole, name), rtol=1e-5)
    np.testing.assert_allclose(numbers(both, "variance"), numbers(whole, "variance"), rtol=1e-3, atol=1e-5)


def test_everything_but_light_is_the_first_ones(arrays):
    one, other = uniform(arrays, 2, 5), uniform(arrays, 3, 5, 0)
    both = merged(one, other)
    for field in fields(Samples):
        if field.name not in ("count", "radiance", "squares"):
            assert getattr(both, field.name) is getattr(one, field.name)


def test_pixels_without_samples_take_what_the_other_has(arrays):
    one, other = uniform(arrays, 2, 4), uniform(arrays, 2, 4, 5)
    none = replace(one, count=floats(arrays, [0, 2, 0, 2]))
    rest = replace(other, count=floats(arrays, [2, 2, 0, 0]))
    both = merged(none, rest)
    assert numbers(both, "count").tolist() == [2, 4, 0, 2]
    np.testing.assert_allclose(numbers(both, "radiance")[[0, 1, 3], 0], [5, 3, 1])
    dark = replace(one, count=floats(arrays, np.zeros(4)))
    for name in ("radiance", "squares", "count"):
        np.testing.assert_array_equal(numbers(merged(dark, other), name), numbers(other, name))


@pytest.mark.parametrize("value", [np.inf, np.nan, 3e38])
def test_what_one_side_lacks_the_other_side_has_as_it_was(arrays, value):
    """0 times infinity is not 0."""
    one, other = uniform(arrays, 2, 2), uniform(arrays, 3, 2, 5)
    broken = [floats(arrays, [value, 1])] * 3
    dark = replace(one, count=floats(arrays, [0, 0]), radiance=broken, squares=broken)
    for both in (merged(dark, other), merged(other, dark)):
        assert numbers(both, "radiance").tolist() == [[5] * 3] * 2
        assert numbers(both, "squares").tolist() == [[25] * 3] * 2


def test_features_are_averaged_by_the_others_share(arrays):
    one, other = uniform(arrays, 2, 3), uniform(arrays, 6, 3)
    found = averaged_features(one, other, floats(arrays, [0, 0.25, 1]))
    for name in ("albedo", "normal"):
        np.testing.assert_allclose(numbers(found, name)[:, 0], [2, 3, 6])
    assert found.position is one.position
    assert found.radiance is one.radiance


def test_some_pixels_are_taken_out_and_put_back(arrays):
    one, other = uniform(arrays, 2, 5), uniform(arrays, 6, 5, 2)
    chosen = indices(arrays, [4, 1])
    part = taken(other, chosen)
    assert numbers(part, "pixels").tolist() == [4, 1]
    whole = put(one, chosen, part)
    assert numbers(whole, "count").tolist() == [2, 6, 2, 2, 6]
    assert numbers(whole, "gloss").tolist() == [2, 6, 2, 2, 6]
    assert numbers(whole, "pixels").tolist() == numbers(one, "pixels").tolist()
    assert numbers(one, "count").tolist() == [2] * 5


def test_channels_that_are_one_array_are_put_one_by_one(arrays):
    """Nothing is known of any channel at first; they share their zeros."""
    none = Samples.none(arrays, indices(arrays, range(4)))
    part = taken(uniform(arrays, 2, 4, 5), indices(arrays, [2]))
    whole = put(none, indices(arrays, [2]), part)
    assert numbers(whole, "radiance").tolist() == [[0] * 3, [0] * 3, [5] * 3, [0] * 3]
    assert not numbers(none, "radiance").any()


def test_nothing_is_known_of_pixels_at_first(arrays):
    none = Samples.none(arrays, indices(arrays, [3, 9]))
    assert none.size == 2
    assert none.mean_count() == 0
    assert np.isinf(numbers(none, "variance")).all()
    assert uniform(arrays, 3, 5).mean_count() == 3


def test_no_pixels_have_no_samples(arrays):
    none = Samples.none(arrays, indices(arrays, []))
    assert none.size == 0
    assert none.mean_count() == 0
    for name in ("radiance", "variance", "position"):
        assert numbers(none, name).shape == (0, 3)
    assert numbers(none, "pixels").shape == (0,)
    assert taken(uniform(arrays, 2, 5), none.pixels).size == 0
