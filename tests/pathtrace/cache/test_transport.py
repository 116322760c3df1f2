"""Transport between cells against a plain float64 twin, and a closed form."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.cache.transport import Links, Patches, Transport
from tests import small

CELLS, POINTS, RAYS = 7, 40, 3


def random_links() -> tuple[Links, np.ndarray]:
    random = small.rng()
    count = POINTS * RAYS
    links = Links(
        np.arange(count) // RAYS,
        random.integers(-1, CELLS, count),
        random.integers(0, 3, count),
        random.uniform(0, 0.5, (count, 3)).astype(np.float32),
    )
    # Points lie in a cell of either level, of both, or in none.
    return links, np.stack([random.integers(-1, 4, POINTS), random.integers(-1, 3, POINTS) + 4 * 1])


def twin(links: Links, cells: np.ndarray, light: np.ndarray, segments: int) -> np.ndarray:
    """Light of at most a number of segments, ray by ray."""
    if segments < 1:
        return np.zeros((CELLS, 3))
    shorter = [twin(links, cells, light, fewer) for fewer in range(segments)]
    sums, rays = np.zeros((CELLS, 3)), np.zeros(CELLS)
    for point, hit, bounces, reflectance in zip(
        links.point, links.cell, links.bounces, links.reflectance, strict=True
    ):
        for cell in cells[:, point]:
            if cell >= 0:
                rays[cell] += 1
                if hit >= 0:
                    sums[cell] += reflectance * shorter[max(segments - 1 - bounces, 0)][hit]
    return light[min(segments, len(light)) - 1] + sums / np.maximum(rays, 1)[:, None]


@pytest.mark.parametrize("kinds", [1, 2, 4])
def test_light_is_passed_on_as_ray_by_ray(kinds):
    """Lights send some light directly, some by way of one mirror, and so on."""
    links, cells = random_links()
    light = small.rng(1).uniform(0, 2, (kinds, CELLS, 3)).astype(np.float32).cumsum(axis=0)
    found = Transport.of(links, *Patches.of(cells, CELLS)).irradiance(light, 3)
    assert found.shape == (3, CELLS, 3)
    for segments in (1, 2, 3):
        np.testing.assert_allclose(found[segments - 1], twin(links, cells, light, segments), rtol=1e-5)


@pytest.mark.parametrize(("most", "steps"), [(1, 1), (8, 8), (20, 8), (-1, 8)])
def test_a_cell_that_sees_itself_is_a_geometric_series(most, steps):
    links = Links(
        np.zeros(4, dtype=int), np.zeros(4, dtype=int), np.zeros(4, dtype=int), np.full((4, 3), 0.5)
    )
    transport = Transport.of(links, *Patches.of(np.zeros((1, 1), dtype=int), 1))
    found = transport.irradiance(np.ones((1, 1, 3), np.float32), most)
    assert found.shape == (steps, 1, 3)
    assert found[0, 0, 0] == pytest.approx(1)
    last = most if most > 0 else 50
    assert found[-1, 0, 0] == pytest.approx(2 * (1 - 0.5**last), rel=1e-5)
