"""The Z-order curve visits the octants of a cube one after another, and so keeps neighbours together."""

from __future__ import annotations

import itertools

import numpy as np

from splat.model.points import z_curve_order


def test_corners_are_visited_with_x_fastest():
    corners = np.array(list(itertools.product([0.0, 1.0], repeat=3)))
    visited = corners[z_curve_order(corners)]
    assert visited.tolist() == [[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]


def test_octants_are_visited_one_after_another():
    points = np.random.default_rng(0).uniform(0, 1, (500, 3))
    # The corners fix the cube.
    points = np.concatenate([points, [[0, 0, 0], [1, 1, 1]]])
    for side in (2, 4, 8):
        cells = np.floor(points[z_curve_order(points)] * side * 0.999999).astype(int) @ [1, side, side**2]
        # As many runs as cells: none is entered twice.
        assert np.count_nonzero(np.diff(cells)) + 1 == len(np.unique(cells))


def test_all_axes_have_one_scale():
    """A long box is cut along its length alone until its cells are cubes."""
    points = np.array([[8.0, 0, 0], [0, 0.4, 0], [0, 0, 0], [8.0, 0.4, 0]])
    assert z_curve_order(points).tolist() == [2, 1, 0, 3]


def test_the_order_in_memory_does_not_matter():
    rng = np.random.default_rng(1)
    # Many points in few cells of the curve, so that keys are equal.
    points = np.concatenate([rng.uniform(-3, 5, (100, 3)), 1e-9 * rng.uniform(0, 1, (100, 3))])
    shuffled = points[rng.permutation(200)]
    np.testing.assert_array_equal(points[z_curve_order(points)], shuffled[z_curve_order(shuffled)])


def test_any_numbers_are_ordered():
    for points in (np.full((4, 3), 2.0), np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, 1.0]])):
        assert sorted(z_curve_order(points).tolist()) == list(range(len(points)))


def test_far_points_leave_the_order_of_near_ones():
    """The sky, 25,000 times as far away as all else, which would otherwise lie in one cell of the curve."""
    rng = np.random.default_rng(2)
    near, sky = rng.uniform(-4, 4, (400, 3)), rng.normal(size=(100, 3))
    sky *= 1e5 / np.linalg.norm(sky, axis=1, keepdims=True)

    def step(points: np.ndarray, order: np.ndarray) -> float:
        order = order[order < len(near)]
        return float(np.linalg.norm(np.diff(points[order], axis=0), axis=1).mean())

    both = np.concatenate([near, sky])
    assert step(both, z_curve_order(both)) < 1.2 * step(near, z_curve_order(near))
