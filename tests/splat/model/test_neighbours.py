"""Nearest neighbours, nearest first."""

from __future__ import annotations

import numpy as np

from splat.model.points import Neighbours


def test_neighbours_by_hand():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [10, 0, 0]])
    found = Neighbours(points, np.array([[0.9, 0, 0], [9, 0, 0]]), 2)
    assert found.index.tolist() == [[1, 0], [3, 2]]
    np.testing.assert_allclose(found.distance, [[0.1, 0.9], [1, 6]])
    # Nothing is missing up to the farthest that is listed.
    np.testing.assert_allclose(found.reach, [0.9, 6])


def test_with_few_points_all_are_listed():
    points = np.array([[0.0, 0, 0], [1, 0, 0]])
    found = Neighbours(points, np.zeros((1, 3)), 5)
    assert found.index.tolist() == [[0, 1]]
    assert found.reach.tolist() == [np.inf]


def test_without_points_there_are_no_neighbours():
    found = Neighbours(np.zeros((0, 3)), np.zeros((2, 3)), 3)
    assert found.index.tolist() == found.distance.tolist() == [[], []]
    assert found.reach.tolist() == [np.inf, np.inf]
