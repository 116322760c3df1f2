"""Light on its way: where it arrives is what the transport gives at once."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.cache.transport import Links, Patches, Transport
from pathtrace.fill.relight import Spreading
from tests import small

CELLS, POINTS, RAYS = 7, 40, 3


@pytest.fixture(scope="module")
def transport() -> Transport:
    random, count = small.rng(), POINTS * RAYS
    links = Links(
        np.arange(count) // RAYS,
        random.integers(-1, CELLS, count),
        random.integers(0, 3, count),
        random.uniform(0, 0.5, (count, 3)).astype(np.float32),
    )
    return Transport.of(links, *Patches.of(random.integers(-1, CELLS, (1, POINTS)), CELLS))


def light(seed: int) -> np.ndarray:
    """Direct light, and more that comes by way of a mirror."""
    return small.rng(seed).uniform(0, 2, (2, CELLS, 3)).astype(np.float32).cumsum(axis=0)


@pytest.mark.parametrize(("most", "steps"), [(1, 0), (2, 1), (4, 3), (8, 7), (20, 7), (-1, 8)])
def test_new_light_has_arrived_after_the_steps(transport, most, steps):
    every, some = np.arange(CELLS), np.array([1, 4])
    spreading = Spreading(transport, light(1), most)
    assert spreading.steps == steps
    np.testing.assert_array_equal(spreading.irradiance(every), transport.irradiance(light(1), most))
    spreading.light(light(2))
    for _ in range(steps):
        spreading.step()
    np.testing.assert_allclose(spreading.irradiance(every), transport.irradiance(light(2), most), rtol=1e-5)
    np.testing.assert_array_equal(spreading.irradiance(some), spreading.irradiance(every)[:, some])


def test_a_restart_begins_with_the_first_segment(transport):
    spreading = Spreading(transport, light(1), 4)
    spreading.step()
    spreading.light(light(2), restart=True)
    for _ in range(spreading.steps):
        spreading.step()
    expected = transport.irradiance(light(2), 4)
    np.testing.assert_allclose(spreading.irradiance(np.arange(CELLS)), expected, rtol=1e-5)
