"""The nodes that touch given cells, against a test of every box with every cell."""

from __future__ import annotations

import numpy as np
import pytest

from splat.lod.footprints import LayerFootprints
from splat.lod.selection import touching
from splat.raster.projection import PIXEL_FILTER

ROWS, COLUMNS = 7, 10


def nodes(arrays, count: int) -> tuple[LayerFootprints, dict[str, np.ndarray]]:
    rng = np.random.default_rng(0)
    numbers = {
        "x": rng.uniform(-60, 16 * COLUMNS + 60, count),
        "y": rng.uniform(-60, 16 * ROWS + 60, count),
        "xx": rng.uniform(0, 60, count),
        "yy": rng.uniform(0, 60, count),
        "extent": np.where(rng.random(count) < 0.1, 0, rng.uniform(0, 11, count)),
    }
    floats = {name: row.astype(np.float32) for name, row in numbers.items()}
    layer = LayerFootprints(*(arrays.plain.Float(row) for row in floats.values()), records=None)
    return layer, {name: row.astype(np.float64) for name, row in floats.items()}


@pytest.mark.parametrize(("blur", "margin"), [(1.0, 0.0), (20.0, 0.0), (2.0, 8.0)])
def test_boxes_touch_cells(arrays, blur, margin):
    cells = np.random.default_rng(1).random((ROWS, COLUMNS)) < 0.15
    layer, n = nodes(arrays, 2000)
    found = touching(arrays, layer, cells, blur, margin).numpy()
    reach = {axis: np.sqrt(n["extent"] * (n[2 * axis] + PIXEL_FILTER * blur**2)) + margin for axis in "xy"}
    expected = np.zeros(2000, dtype=bool)
    for row, column in np.argwhere(cells):
        beside = (n["x"] + reach["x"] <= 16 * column) | (n["x"] - reach["x"] >= 16 * (column + 1))
        above = (n["y"] + reach["y"] <= 16 * row) | (n["y"] - reach["y"] >= 16 * (row + 1))
        expected |= ~beside & ~above & (n["extent"] > 0)
    assert 0.02 < expected.mean() < 0.98
    np.testing.assert_array_equal(found, expected)


def test_boxes_without_a_size_touch_nothing(arrays):
    Float, n = arrays.plain.Float, float("nan")
    inf = float("inf")
    rows = [(8, 8, n, 1, 5), (8, 8, 1, 1, n), (8, 8, inf, 1, 5), (8, 8, 1, 1, 5)]
    layer = LayerFootprints(*(Float(list(column)) for column in zip(*rows, strict=True)), records=None)
    found = touching(arrays, layer, np.ones((1, 1), dtype=bool), 1.0, 0.0)
    assert found.numpy().tolist() == [False, False, False, True]


def test_no_cells_are_touched_by_nothing(arrays):
    layer, _ = nodes(arrays, 50)
    assert not touching(arrays, layer, np.zeros((ROWS, COLUMNS), dtype=bool), 1.0, 0.0).numpy().any()
