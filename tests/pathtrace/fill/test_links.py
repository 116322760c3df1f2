"""Links of rays: what they hit, and what stands for it where nothing is known."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.cache.cells import SIDES, Cells, Grid, Points
from pathtrace.fill.filling import cells_hit, links_of
from pathtrace.fill.gather import Seen
from tests import small

UP = np.float32([0, 1, 0])


def points(*position: tuple[float, float, float], normal: np.ndarray = UP) -> Points:
    return Points(np.float32(position), np.tile(normal, (len(position), 1)))


def cells_of(some: Points) -> Cells:
    grid = Grid(np.zeros(3, dtype=np.float32), 1.0)
    return Cells.of(some, grid, lambda one, other, side: np.ones(len(one), dtype=bool))


def seen(hits: Points, valid: list[bool] | None = None) -> Seen:
    count = len(hits)
    arrived = np.ones(count, dtype=bool) if valid is None else np.array(valid)
    reflectance = small.rng().uniform(0.1, 0.5, (count, 3)).astype(np.float32) * arrived[:, None]
    return Seen(
        np.arange(count),
        np.zeros((count, 2), np.float32),
        np.zeros((count, 3), np.float32),
        np.ones(count, dtype=np.int64),
        hits,
        arrived,
        np.zeros(count, dtype=bool),
        np.arange(count) % 2,
        reflectance,
    )


def test_a_hit_in_cells_belongs_to_the_smallest():
    known = points((0.01, 0, 0.01), (0.3, 0, 0.3))
    cells = cells_of(known)
    hits = points((0.015, 0, 0.012), (0.07, 0, 0.07), (0.39, 0, 0.1))
    indices = cells.indices(hits)
    assert cells_hit(seen(hits), known, cells).tolist() == [indices[0, 0], indices[1, 1], indices[2, 2]]


@pytest.mark.parametrize("normal", [UP, -UP])
def test_a_hit_in_no_cell_belongs_to_the_nearest_point_that_faces_the_same_way(normal):
    floor, ceiling = points((0, 0, 0), (2, 0, 0)), points((0, 0.01, 0), (2.1, 0.01, 0), normal=-UP)
    known = Points(
        np.concatenate([floor.position, ceiling.position]), np.concatenate([floor.normal, ceiling.normal])
    )
    cells = cells_of(known)
    far = points((1.95, 0, 0), normal=normal)
    assert (cells.indices(far) == -1).all()
    nearest = points((2 if normal is UP else 2.1, 0 if normal is UP else 0.01, 0), normal=normal)
    assert cells_hit(seen(far), known, cells) == cells.indices(nearest)[0]


def test_a_ray_that_leaves_the_scene_hits_no_cell():
    known = points((0, 0, 0))
    hits = points((0, 0, 0), (0, 0, 0))
    assert cells_hit(seen(hits, [False, True]), known, cells_of(known))[0] == -1


def test_links_keep_rays_that_leave_and_weigh_what_others_bring():
    found = seen(points((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0)), [True, False, True, True])
    weight = np.float32([0.5, 1.5, 2, 1])
    links = links_of(found, np.array([4, -1, -1, 2]), weight)
    # The third hit something of which nothing can be said.
    assert links.point.tolist() == [0, 1, 3]
    assert links.cell.tolist() == [4, -1, 2]
    assert links.bounces.tolist() == [0, 1, 1]
    np.testing.assert_allclose(links.reflectance, (weight[:, None] * found.reflectance)[[0, 1, 3]])


def test_cells_are_of_several_sizes():
    """What the cases above rely on."""
    assert tuple(sorted(SIDES)) == SIDES
    assert SIDES[0] < 0.06 < SIDES[1] < 0.2 < SIDES[2] <= 0.4
