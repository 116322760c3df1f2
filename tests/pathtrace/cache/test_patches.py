"""Patches: sums over them give the means over cells that sums over points give."""

from __future__ import annotations

import numpy as np

from pathtrace.cache.transport import Patches, sums_by
from tests import small

CELLS = 12


def nested(count: int = 300) -> np.ndarray:
    """(2, N) cells of points: 9 small ones inside of 3 large ones, some unknown."""
    small_cell = small.rng().integers(0, 9, count)
    cells = np.stack([small_cell, 9 + small_cell // 3])
    cells[0, small_cell == 4] = -1
    cells[:, small_cell == 8] = -1
    return cells


def test_means_over_cells_are_those_of_their_points():
    cells, values = nested(), small.rng(1).uniform(size=(300, 3))
    patches, patch = Patches.of(cells, CELLS)
    assert len(patches) == 9
    assert (patches.cells[:, patch] == cells).all()
    numbers = np.bincount(patch, minlength=len(patches))
    means = patches.averaging(numbers) @ sums_by(patch, values, len(patches))
    for cell in range(CELLS):
        inside = (cells == cell).any(axis=0)
        expected = values[inside].mean(axis=0) if inside.any() else np.zeros(3)
        np.testing.assert_allclose(means[cell], expected, rtol=1e-5)


def test_patches_of_one_largest_cell_are_one_region():
    patches, patch = Patches.of(nested(), CELLS)
    largest = nested().max(axis=0)
    region = patches.regions[patch]
    assert len(np.unique(region)) == len(np.unique(largest)) == 4
    assert (region.max(), region.min()) == (3, 0)
    for number in range(4):
        assert len(np.unique(largest[region == number])) == 1


def test_there_may_be_no_patches():
    patches = Patches(np.zeros((1, 0), dtype=np.int32), 0)
    assert len(patches.regions) == 0
    assert patches.averaging(np.zeros(0, dtype=np.int64)).shape == (0, 0)
