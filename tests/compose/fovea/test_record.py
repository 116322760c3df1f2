"""Records: to sums and back."""

from __future__ import annotations

import numpy as np

from compose.fovea.record import RECORD, add_features, add_light, limit, means
from compose.fovea.samples import Samples
from tests import small
from tests.compose.fovea.views import camera, samples, wall

PIXELS = 48 * 48


def seen(radiance: np.ndarray, albedo: np.ndarray, count: int = 3) -> Samples:
    """Samples whose normals are the opposite of their albedo."""
    new = samples(wall(camera()), radiance, count=count)
    return Samples(**{**vars(new), "albedo": albedo, "normal": -albedo})


def values() -> tuple[np.ndarray, np.ndarray]:
    """Radiance and albedo."""
    rng = small.rng()
    radiance, albedo = (rng.uniform(0, 2, (PIXELS, 3)).astype(np.float32) for _ in range(2))
    return radiance, albedo


def test_records_are_counts_and_sums():
    radiance, albedo = values()
    records = np.zeros((PIXELS, RECORD), dtype=np.float32)
    new = seen(radiance, albedo)
    add_light(records, new)
    add_features(records, new, 5)
    assert (records[:, 0] == 3).all()
    np.testing.assert_allclose(records[:, 1:4], 3 * radiance, rtol=1e-6)
    np.testing.assert_allclose(records[:, 4:7], 3 * radiance**2, rtol=1e-6)
    assert (records[:, 7] == 5).all()
    np.testing.assert_allclose(records[:, 8:11], 5 * albedo, rtol=1e-6)
    np.testing.assert_allclose(records[:, 11:14], -5 * albedo, rtol=1e-6)
    assert not records[:, 14:].any()


def test_records_add_up():
    """Three samples and three of the opposite radiance; features of 5 positions and of 15."""
    radiance, albedo = values()
    one, other = np.zeros((2, PIXELS, RECORD), dtype=np.float32)
    for records, sign, positions in ((one, 1, 5), (other, -1, 15)):
        add_light(records, seen(sign * radiance, albedo))
        add_features(records, seen(radiance, positions * albedo), positions)
    count, mean, squares, found_albedo, normal = means(one + other)
    assert (count == 6).all()
    np.testing.assert_allclose(mean, 0, atol=1e-6)
    np.testing.assert_allclose(squares, radiance**2, rtol=1e-6)
    np.testing.assert_allclose(found_albedo, 12.5 * albedo, rtol=1e-6)
    np.testing.assert_allclose(normal, -12.5 * albedo, rtol=1e-6)


def test_limited_records_have_the_same_means():
    radiance, albedo = values()
    records = np.zeros((PIXELS, RECORD), dtype=np.float32)
    add_light(records, seen(radiance, albedo, count=100))
    add_features(records, seen(radiance, albedo), 5)
    limited = records.copy()
    limit(limited, 32)
    np.testing.assert_allclose(limited[:, 0], 32, rtol=1e-6)
    assert (limited[:, 7] == 5).all()
    for one, other in zip(means(limited)[1:], means(records)[1:], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)


def test_the_mean_of_nothing_is_0():
    assert not any(part.any() for part in means(np.zeros((2, RECORD), dtype=np.float32)))
