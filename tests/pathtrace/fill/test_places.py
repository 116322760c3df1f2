"""Light at points from what rays found: sums, depths of light by way of mirrors, and another order."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.cache.cells import Cells, Grid, Points
from pathtrace.fill.filling import GuidedPlaces, shuffled
from pathtrace.fill.gather import Seen
from tests import small

COUNT, RAYS = 50, 4


@pytest.fixture(scope="module")
def places() -> GuidedPlaces:
    """Points in two places far from each other."""
    random = small.rng()
    position = random.uniform(0, 0.3, (COUNT, 3)).astype(np.float32)
    position[COUNT // 2 :, 0] += 4
    position[:, 1] = 0.1
    points = Points(position, np.tile(np.float32([0, 1, 0]), (COUNT, 1)))
    grid = Grid(np.zeros(3, dtype=np.float32), 1.0)
    cells = Cells.of(points, grid, lambda one, other, side: np.ones(len(one), dtype=bool))
    return GuidedPlaces(points, cells, random.uniform(0, 1, (COUNT, 3)).astype(np.float32))


@pytest.fixture(scope="module")
def seen() -> Seen:
    """Rays that meet mirrors and leave the scene; lights by way of 1 or 3 mirrors, or of 2."""
    random, rays = small.rng(1), COUNT * RAYS
    point = np.repeat(np.arange(COUNT), RAYS)
    radiance = random.uniform(0, 1, (rays, 3)).astype(np.float32)
    passed = np.where(point < COUNT // 2, 1 + 2 * (np.arange(rays) % 2), 2)
    return Seen(
        point,
        random.uniform(size=(rays, 2)).astype(np.float32),
        radiance,
        passed,
        Points(np.zeros((rays, 3), np.float32), np.zeros((rays, 3), np.float32)),
        np.zeros(rays, dtype=bool),
        random.uniform(size=rays) < 0.8,
        np.ones(rays, dtype=np.int64),
        np.zeros((rays, 3), np.float32),
    )


def test_light_of_mirrors_is_pi_times_the_weighted_mean_of_the_rays(places, seen):
    weight = small.rng(2).uniform(0.5, 1.5, len(seen.point)).astype(np.float32)
    found = places.transfer(seen, np.full(len(seen.point), -1), weight)
    for region in (0, 1):
        points = places.regions[seen.point] == region
        expected = np.pi / RAYS * (weight[:, None] * seen.radiance)[points].sum(axis=0)
        np.testing.assert_allclose(found.reflected[region], expected, rtol=1e-5)
    np.testing.assert_allclose(found.rays.weight, np.pi / RAYS * weight[seen.shiny], rtol=1e-6)
    np.testing.assert_array_equal(found.rays.point, seen.point[seen.shiny])
    np.testing.assert_allclose(found.direct.sum(axis=0), places.direct.sum(axis=0), rtol=1e-5)


def test_shares_follow_the_number_of_mirrors(places, seen):
    found = places.transfer(seen, np.full(len(seen.point), -1), np.ones(len(seen.point), np.float32))
    light = seen.radiance.mean(axis=1)[seen.point < COUNT // 2]
    once = light[::2].sum() / light.sum()
    np.testing.assert_allclose(found.passed[:, places.regions[0]], [once, once, 1], rtol=1e-5)
    np.testing.assert_allclose(found.passed[:, places.regions[-1]], [0, 1, 1], rtol=1e-5)
    # A path that may take one segment more sees no mirror, two more see one.
    irradiance = found.irradiance(4)
    direct, every = irradiance[0].mean(), irradiance[3].mean()
    assert direct < irradiance[1].mean() < irradiance[2].mean() < every
    np.testing.assert_allclose(irradiance[0], found.of_cells(found.direct, 0 * found.reflected)[0], rtol=1e-6)


def test_another_order_changes_nothing(places, seen):
    found = places.transfer(seen, np.full(len(seen.point), -1), np.ones(len(seen.point), np.float32))
    other = shuffled(found, small.rng(3))
    other.check()
    assert (other.points.position != found.points.position).any()
    np.testing.assert_array_equal(other.irradiance(4), found.irradiance(4))
    start = lambda transfer: transfer.points.position[transfer.rays.point]  # noqa: E731
    key = lambda transfer: np.argsort(transfer.rays.square[:, 0])  # noqa: E731
    np.testing.assert_array_equal(start(other)[key(other)], start(found)[key(found)])
    np.testing.assert_array_equal(np.bincount(other.patch), np.bincount(found.patch))
