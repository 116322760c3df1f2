"""What a cache keeps to follow lights: means over cells, and parts that match each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pathtrace.cache.cells import Points
from pathtrace.cache.transport import Links, Patches, Rays, Transfer, Transport, sums_by
from tests import small

POINTS, CELLS = 60, 8
PARTS = [
    *("patch", "direct", "reflected", "passed", "never passed", "points", "rays", "weight", "nan"),
    *("starts", "links"),
]


@pytest.fixture(scope="module")
def transfer() -> Transfer:
    """Six small cells inside of two large ones."""
    random = small.rng()
    cell = random.integers(0, 6, POINTS)
    patches, patch = Patches.of(np.stack([cell, 6 + cell // 3]), CELLS)
    links = Links(
        np.arange(POINTS),
        random.integers(-1, CELLS, POINTS),
        np.zeros(POINTS, dtype=np.int64),
        random.uniform(0, 0.5, (POINTS, 3)).astype(np.float32),
    )
    position = random.uniform(size=(POINTS, 3)).astype(np.float32)
    square, weight = random.uniform(size=(30, 2)), random.uniform(size=30)
    start = np.arange(0, POINTS, 2, dtype=np.int32)
    rays = Rays(start, square.astype(np.float32), weight.astype(np.float32))
    light = random.uniform(size=(POINTS, 3)).astype(np.float32)
    sums = sums_by(patch, light, len(patches)), sums_by(patches.regions[patch], light, 2)
    return Transfer(
        Points(position, position),
        patch,
        rays,
        *(part.astype(np.float32) for part in sums),
        np.float32([[0.25, 0.5], [1, 1]]),
        Transport.of(links, patches, patch),
        np.ones(CELLS, dtype=bool),
    )


def test_light_of_mirrors_is_the_mean_of_a_region(transfer):
    patches = transfer.transport.patches
    found = transfer.of_cells(np.zeros_like(transfer.direct), transfer.reflected)
    region = patches.regions
    points = np.bincount(region, transfer.numbers)
    # Of direct light there is none; then that which met one surface, then all.
    assert (found[0] == 0).all()
    for cells in patches.cells:
        means = (transfer.reflected / points[:, None])[region]
        np.testing.assert_allclose(found[2][cells], means, rtol=1e-5)
        share = np.float32([0.25, 0.5])[region][:, None]
        np.testing.assert_allclose(found[1][cells], share * means, rtol=1e-5)


def test_direct_light_is_the_mean_of_each_cell(transfer):
    found = transfer.of_cells(transfer.direct, np.zeros_like(transfer.reflected))
    for cell in range(CELLS):
        patches = (transfer.transport.patches.cells == cell).any(axis=0)
        expected = transfer.direct[patches].sum(axis=0) / transfer.numbers[patches].sum()
        np.testing.assert_allclose(found[:, cell], [expected] * 3, rtol=1e-5)


def test_rays_start_in_the_regions_of_their_points(transfer):
    region = transfer.transport.patches.regions[transfer.patch]
    np.testing.assert_array_equal(transfer.ray_regions, region[::2])


def test_memory_is_that_of_all_parts(transfer):
    transport = transfer.transport
    assert transfer.bytes > transport.bytes > transport.reflectance.nbytes + transport.cells.nbytes
    assert Transfer.none().bytes < 100


def test_parts_that_match_are_accepted(transfer):
    transfer.check()
    Transfer.none().check()


@pytest.mark.parametrize("part", PARTS)
def test_parts_that_do_not_match_are_refused(transfer, part):
    transport = transfer.transport
    changes = {
        "patch": {"patch": transfer.patch + np.int32(1)},
        "direct": {"direct": transfer.direct[1:]},
        "reflected": {"reflected": transfer.reflected[1:]},
        "passed": {"passed": transfer.passed[:, 1:]},
        "never passed": {"passed": transfer.passed[:0]},
        "points": {"points": transfer.points.take(np.arange(3))},
        "rays": {"rays": replace(transfer.rays, point=transfer.rays.point - np.int32(1))},
        "weight": {"rays": replace(transfer.rays, weight=transfer.rays.weight[1:])},
        "nan": {"direct": np.full_like(transfer.direct, np.nan)},
        "starts": {"transport": replace(transport, starts=transport.starts[:-1])},
        "links": {"transport": replace(transport, cells=transport.cells + np.int32(CELLS))},
    }
    with pytest.raises(ValueError, match="do not match"):
        replace(transfer, **changes[part]).check()
