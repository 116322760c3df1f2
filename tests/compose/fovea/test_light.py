"""Light records: to sums and back."""

from __future__ import annotations

import numpy as np

from compose.fovea.light import LIGHT, light_of, means
from tests import small
from tests.compose.fovea.views import camera, samples, wall


def test_records_are_counts_and_sums():
    radiance = small.rng().uniform(0, 2, (48 * 48, 3)).astype(np.float32)
    new = samples(wall(camera()), radiance, count=3)
    light = light_of(new)
    assert light.shape == (48 * 48, LIGHT)
    assert light.dtype == np.float32
    assert (light[:, 0] == 3).all()
    np.testing.assert_allclose(light[:, 1:4], 3 * radiance, rtol=1e-6)
    np.testing.assert_allclose(light[:, 4:7], 3 * radiance**2, rtol=1e-6)
    assert (light[:, 7] == 0).all()
    # Records add up: three samples and three of the opposite radiance.
    count, mean, squares = means(light + light_of(samples(wall(camera()), -radiance, count=3)))
    assert (count == 6).all()
    np.testing.assert_allclose(mean, 0, atol=1e-6)
    np.testing.assert_allclose(squares, radiance**2, rtol=1e-6)


def test_the_mean_of_no_samples_is_0():
    count, mean, squares = means(np.zeros((2, LIGHT), dtype=np.float32))
    assert not count.any()
    assert not mean.any()
    assert not squares.any()
