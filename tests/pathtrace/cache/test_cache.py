"""Look-ups of irradiance: by place, by spread, by segments left."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from pathtrace.cache.cells import SIDES, Cells, Grid, Points
from pathtrace.cache.irradiance_cache import IrradianceCache, look_up
from pathtrace.cache.transport import Transfer
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
SCALE = 2.0


@pytest.fixture(scope="module")
def floor(backend) -> IrradianceCache:
    """A floor from x = 0 to 1.6 whose irradiance is 1 + the index of the cell, plus 1000 for each segment."""
    random = small.rng()
    position = random.uniform(0, 0.8 * SCALE, (80_000, 3)).astype(np.float32)
    position[:, 1] = 0.003
    points = Points(position, np.tile(np.float32([0, 1, 0]), (len(position), 1)))
    grid = Grid(np.zeros(3, dtype=np.float32), SCALE)
    cells = Cells.of(points, grid, lambda one, other, side: np.ones(len(one), dtype=bool)).only_known()
    values = 1 + np.arange(len(cells)) + 1000.0 * np.arange(1, 4)[:, None]
    return IrradianceCache(
        cells,
        np.repeat(values[..., None], 3, axis=2).astype(np.float32),
        IrradianceCache.empty(1).lights,
        Transfer.none(),
    )


def asked(cache, points: Points, area, segments=1, jitter=(0.5, 0.5), active=True):
    scene = mi.load_dict({"type": "scene", "light": {"type": "constant"}})
    known, irradiance = look_up(
        cache.arrays(scene).irradiance,
        mi.Point3f(points.position.T),
        mi.Normal3f(points.normal.T),
        mi.Float(area),
        mi.UInt32(segments),
        mi.Point2f(*jitter),
        mi.Bool(active),
    )
    dr.eval(known, irradiance)
    return known.numpy(), irradiance.numpy().T


def queries(count: int = 500) -> Points:
    position = small.rng(1).uniform(0.1, 0.7 * SCALE, (count, 3)).astype(np.float32)
    position[:, 1] = 0.003
    return Points(position, np.tile(np.float32([0, 1, 0]), (count, 1)))


def test_the_smallest_cells_answer(floor):
    points = queries()
    known, irradiance = asked(floor, points, 1e6)
    cell = floor.cells.smallest(points)
    assert known.all()
    assert (irradiance == (1001 + cell)[:, None]).all()


@pytest.mark.parametrize("segments", [1, 2, 3, 9])
def test_fewer_segments_left_give_the_light_of_fewer(floor, segments):
    points = queries()
    _, irradiance = asked(floor, points, 1e6, segments)
    assert (irradiance[:, 0] == 1 + floor.cells.smallest(points) + 1000 * min(segments, 3)).all()


@pytest.mark.parametrize("level", [0, 1, 2])
def test_cells_are_no_larger_than_the_spread(floor, level):
    points, side = queries(), SIDES[level] * SCALE
    known, irradiance = asked(floor, points, 0.99 * side**2)
    indices = floor.cells.indices(points)
    if level == 0:
        assert not known.any()
    else:
        assert known.all()
        assert (irradiance[:, 0] == 1001 + indices[0]).all()


def test_larger_cells_answer_where_no_small_one_is_known(floor):
    sparse = Cells(
        floor.cells.grid,
        (floor.cells.keys[0][:0], *floor.cells.keys[1:]),
        (floor.cells.counts[0][:0], *floor.cells.counts[1:]),
    )
    cache = replace(floor, cells=sparse, irradiance=floor.irradiance[:, len(floor.cells.keys[0]) :])
    points = queries()
    for level in (1, 2):
        known, irradiance = asked(cache, points, 1.01 * (SIDES[level] * SCALE) ** 2)
        assert known.all()
        assert (irradiance[:, 0] == 1001 + len(floor.cells.keys[0]) + sparse.indices(points)[1]).all()


def test_another_side_and_other_places_are_unknown(floor):
    points = queries(50)
    for other in (Points(points.position, -points.normal), Points(points.position + 100, points.normal)):
        known, irradiance = asked(floor, other, 1e6)
        assert not known.any()
        assert (irradiance == 0).all()
    assert not asked(floor, points, 1e6, active=False)[0].any()


def test_jitter_reaches_half_a_cell_to_each_side(floor):
    side = SIDES[0] * SCALE
    middle = Points(np.float32([[10.5 * side, 0.003, 10.5 * side]]), np.float32([[0, 1, 0]]))
    there = lambda x, y: Points(middle.position + np.float32([x * side, 0, y * side]), middle.normal)  # noqa: E731
    around = {int(floor.cells.smallest(there(x, y))[0]) for x in (-0.4, 0.4) for y in (-0.4, 0.4)}
    assert len(around) == 1
    reached = {
        round(float(asked(floor, middle, 1e6, jitter=(x, y))[1][0, 0])) - 1001
        for x in (0.01, 0.5, 0.99)
        for y in (0.01, 0.5, 0.99)
    }
    assert reached == around
    edge = there(0.45, 0)
    reached = {
        round(float(asked(floor, edge, 1e6, jitter=(x, y))[1][0, 0])) - 1001
        for x in (0.01, 0.5, 0.99)
        for y in (0.01, 0.5, 0.99)
    }
    assert len(reached) == 2


def test_memory_counts_the_table_and_the_values(floor):
    table = floor.bytes - floor.irradiance.nbytes
    assert 8 * 3 * len(floor.cells) < table <= 8 * 64 * len(floor.cells)


def test_an_empty_cache_answers_nobody():
    points = queries(10)
    assert not asked(IrradianceCache.empty(3), points, 1e6)[0].any()


def test_a_cell_answers_for_a_neighbour_that_is_not_known(floor):
    """Rather than a larger cell, which reaches further."""
    side, up = SIDES[0] * SCALE, np.float32([[0, 1, 0]])
    inside = Points(np.float32([[10.9 * side, 0.003, 10.5 * side]]), up)
    beside = Points(np.float32([[11.1 * side, 0.003, 10.5 * side]]), up)
    own, other = (int(floor.cells.smallest(points)[0]) for points in (inside, beside))
    assert own != other
    keys, counts = floor.cells.keys, floor.cells.counts
    cells = Cells(
        floor.cells.grid, (np.delete(keys[0], other), *keys[1:]), (np.delete(counts[0], other), *counts[1:])
    )
    cache = replace(floor, cells=cells, irradiance=np.delete(floor.irradiance, other, axis=1))
    reached = {
        round(float(asked(cache, inside, 1e6, jitter=(x, y))[1][0, 0])) - 1001
        for x in (0.01, 0.5, 0.99)
        for y in (0.3, 0.5, 0.7)
    }
    assert own in reached
    assert reached <= set(range(len(keys[0])))
