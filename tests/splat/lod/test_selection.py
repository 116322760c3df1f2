"""The nodes that touch given cells, against a test of every box with every cell."""

from __future__ import annotations

from types import SimpleNamespace

import drjit as dr
import numpy as np
import pytest

from splat.lod.layer_images import AtlasEntry, EntryTable, LayerImage, touching
from splat.raster.projection import PIXEL_FILTER

ROWS, COLUMNS = 7, 10
COUNT = 2000


def nodes() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    numbers = {
        "x": rng.uniform(-60, 16 * COLUMNS + 60, COUNT),
        "y": rng.uniform(-60, 16 * ROWS + 60, COUNT),
        "xx": rng.uniform(0, 60, COUNT),
        "yy": rng.uniform(0, 60, COUNT),
        "opacity": np.where(rng.random(COUNT) < 0.1, 0, rng.uniform(0, 1, COUNT)),
    }
    return {name: row.astype(np.float32) for name, row in numbers.items()}


def found(arrays, floats: dict[str, np.ndarray], parts: list[tuple[np.ndarray, range, float, int]]):
    """Which candidates are selected, by entry: of cells, range of nodes, blur and rate."""
    rows = {name: arrays.plain.Float(row) for name, row in floats.items()}
    shape = parts[0][0].shape[0] + 1, parts[0][0].shape[1] + 1
    weight = np.ones(shape, dtype=np.float32)
    entries = [AtlasEntry(LayerImage(1, rate, weight), 0, cells, cells) for cells, _, _, rate in parts]
    blurs = [(blur, 1.0) for _, _, blur, _ in parts]
    table = EntryTable.of_entries(arrays, entries, [part for _, part, _, _ in parts], blurs, weight)
    gathered = lambda index: SimpleNamespace(  # noqa: E731
        **{name: dr.gather(arrays.plain.Float, row, index) for name, row in rows.items()}
    )
    mask, sizes = touching(arrays, table, gathered).numpy(), [len(part) for _, part, _, _ in parts]
    assert not mask[sum(sizes) :].any()
    return np.split(mask[: sum(sizes)], np.cumsum(sizes)[:-1])


def expected(n: dict[str, np.ndarray], cells: np.ndarray, blur: float, margin: float) -> np.ndarray:
    n = {name: row.astype(np.float64) for name, row in n.items()}
    extent = 2 * np.log(np.maximum(n["opacity"] * 255, 1))
    reach = {axis: np.sqrt(extent * (n[2 * axis] + PIXEL_FILTER * blur**2)) + margin for axis in "xy"}
    touched = np.zeros(len(extent), dtype=bool)
    for row, column in np.argwhere(cells):
        beside = (n["x"] + reach["x"] <= 16 * column) | (n["x"] - reach["x"] >= 16 * (column + 1))
        above = (n["y"] + reach["y"] <= 16 * row) | (n["y"] - reach["y"] >= 16 * (row + 1))
        touched |= ~beside & ~above & (extent > 0)
    return touched


@pytest.mark.parametrize(("blur", "rate"), [(1.0, 0), (20.0, 0), (2.0, 3)])
def test_boxes_touch_cells(arrays, blur, rate):
    cells = np.random.default_rng(1).random((ROWS, COLUMNS)) < 0.15
    (mask,) = found(arrays, nodes(), [(cells, range(COUNT), blur, rate)])
    touched = expected(nodes(), cells, blur, 2.0**rate if rate else 0.0)
    assert 0.02 < touched.mean() < 0.98
    np.testing.assert_array_equal(mask, touched)


def test_entries_have_cells_and_nodes_of_their_own(arrays):
    """Three entries at once, the first two of one layer, and one without any node."""
    rng, n = np.random.default_rng(2), nodes()
    parts = [
        (rng.random((ROWS, COLUMNS)) < 0.1, part, blur, rate)
        for part, blur, rate in (
            (range(700, COUNT), 1.0, 0),
            (range(700, COUNT), 4.0, 2),
            (range(700, 700), 1.0, 0),
            (range(0, 700), 9.0, 1),
        )
    ]
    for mask, (cells, part, blur, rate) in zip(found(arrays, n, parts), parts, strict=True):
        own = {name: row[part.start : part.stop] for name, row in n.items()}
        np.testing.assert_array_equal(mask, expected(own, cells, blur, 2.0**rate if rate else 0.0))


def test_boxes_without_a_size_touch_nothing(arrays):
    n, inf = float("nan"), float("inf")
    rows = np.float32([(8, 8, n, 1, 0.5), (8, 8, 1, 1, n), (8, 8, inf, 1, 0.5), (8, 8, 1, 1, 0.5)])
    floats = {name: row.copy() for name, row in zip(("x", "y", "xx", "yy", "opacity"), rows.T, strict=True)}
    (mask,) = found(arrays, floats, [(np.ones((1, 1), dtype=bool), range(4), 1.0, 0)])
    assert mask.tolist() == [False, False, False, True]


def test_no_cells_are_touched_by_nothing(arrays):
    (mask,) = found(arrays, nodes(), [(np.zeros((ROWS, COLUMNS), dtype=bool), range(COUNT), 1.0, 0)])
    assert not mask.any()
