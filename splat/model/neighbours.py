"""Nearest neighbours of many points at once."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from splat.model.rows import Floats


class Neighbours:
    """The nearest `count` of M points to each of N positions.

    Args:
        points: (M, 3).
        positions: (N, 3).
        count: neighbours per position; all M if there are fewer.

    Attributes:
        distance, index: for each position, lists over its neighbours, nearest first.
        reach: for each position, the distance up to which no point is missing; infinite if all M are listed.
    """

    def __init__(self, points: Floats, positions: Floats, count: int):
        count = min(count, len(points))
        self.distance: list[list[float]] = [[]] * len(positions)
        self.index: list[list[int]] = [[]] * len(positions)
        self.reach = [np.inf] * len(positions)
        if count:
            distance, index = cKDTree(points).query(positions, k=np.arange(1, count + 1), workers=-1)
            self.distance, self.index = distance.tolist(), index.tolist()
            if count < len(points):
                self.reach = distance[:, -1].tolist()
