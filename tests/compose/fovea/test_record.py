"""Records: to sums and back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.fovea.samples import RECORD, Samples, limited, means, with_features, with_light
from tests import small
from tests.compose.arrays_of import channels, host, numbers
from tests.compose.fovea.views import camera, samples, wall

PIXELS = 48 * 48


def seen(arrays: Arrays, radiance: np.ndarray, albedo: np.ndarray, count: float = 3) -> Samples:
    """Samples whose normals are the opposite of their albedo."""
    new = samples(wall(camera()), radiance, count=count)
    return replace(new, albedo=albedo, normal=-albedo).on(arrays)


def values() -> tuple[np.ndarray, np.ndarray]:
    """Radiance and albedo."""
    rng = small.rng()
    radiance, albedo = (rng.uniform(0, 2, (PIXELS, 3)).astype(np.float32) for _ in range(2))
    return radiance, albedo


def nothing(arrays: Arrays, size: int = PIXELS) -> list[Any]:
    """Records of pixels of which nothing is known."""
    return channels(arrays, np.zeros((size, RECORD)))


def means_of(records: list[Any]) -> tuple[np.ndarray, ...]:
    """(D,) counts, and (D, 3) means of radiance, squares, albedo and normal."""
    count, *triples = means(records)
    return np.array(count), *(host(triple) for triple in triples)


def test_records_are_counts_and_sums(arrays):
    radiance, albedo = values()
    new = seen(arrays, radiance, albedo)
    found = with_features(with_light(nothing(arrays), new), new, 5)
    assert len(found) == RECORD
    records = host(found)
    assert (records[:, 0] == 3).all()
    np.testing.assert_allclose(records[:, 1:4], 3 * radiance, rtol=1e-6)
    np.testing.assert_allclose(records[:, 4:7], 3 * radiance**2, rtol=1e-6)
    assert (records[:, 7] == 5).all()
    np.testing.assert_allclose(records[:, 8:11], 5 * albedo, rtol=1e-6)
    np.testing.assert_allclose(records[:, 11:14], -5 * albedo, rtol=1e-6)
    assert not records[:, 14:].any()


def test_records_add_up(arrays):
    """Three samples and three of the opposite radiance; features of 5 positions and of 15."""
    radiance, albedo = values()
    found = nothing(arrays)
    for sign, positions in ((1, 5), (-1, 15)):
        found = with_light(found, seen(arrays, sign * radiance, albedo))
        found = with_features(found, seen(arrays, radiance, positions * albedo), positions)
    count, mean, squares, found_albedo, normal = means_of(found)
    assert (count == 6).all()
    np.testing.assert_allclose(mean, 0, atol=1e-6)
    np.testing.assert_allclose(squares, radiance**2, rtol=1e-6)
    np.testing.assert_allclose(found_albedo, 12.5 * albedo, rtol=1e-6)
    np.testing.assert_allclose(normal, -12.5 * albedo, rtol=1e-6)


def test_limited_records_have_the_same_means(arrays):
    radiance, albedo = values()
    records = with_light(nothing(arrays), seen(arrays, radiance, albedo, count=100))
    records = with_features(records, seen(arrays, radiance, albedo), 5)
    few = limited(records, 32)
    np.testing.assert_allclose(few[0], 32, rtol=1e-6)
    assert (np.array(few[7]) == 5).all()
    for one, other in zip(means_of(few)[1:], means_of(records)[1:], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)


def test_the_mean_of_nothing_is_0(arrays):
    assert not any(part.any() for part in means_of(nothing(arrays, 2)))


def plain_sums(records: np.ndarray, new: Samples, positions: int, most: float) -> np.ndarray:
    """(D, 16) records in float64, with light and features added, then limited."""
    records, count = records.astype(np.float64), numbers(new, "count")[:, None]
    records[:, 0] += count[:, 0]
    records[:, 1:4] += numbers(new, "radiance") * count
    records[:, 4:7] += numbers(new, "squares") * count
    records[:, 7] += positions
    records[:, 8:11] += numbers(new, "albedo") * np.float64(positions)
    records[:, 11:14] += numbers(new, "normal") * np.float64(positions)
    for number, part in ((0, slice(0, 7)), (7, slice(7, 14))):
        records[:, part] *= np.minimum(most / np.maximum(records[:, number, None], 1e-6), 1)
    return records


@pytest.mark.parametrize("most", [0.5, 32.0, 1e6])
def test_records_match_a_plain_twin(arrays, most):
    rng, (radiance, albedo) = small.rng(3), values()
    before = rng.lognormal(0, 2, (PIXELS, RECORD)).astype(np.float32)
    before[:, 14:] = 0
    new = seen(arrays, radiance, albedo, count=7)
    found = limited(with_features(with_light(channels(arrays, before), new), new, 4), most)
    np.testing.assert_allclose(host(found), plain_sums(before, new, 4, most), rtol=1e-5, atol=1e-6)
