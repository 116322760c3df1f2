"""Nearest neighbours of many points at once."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from splat.model.rows import Floats, Ints


class Neighbours:
    """The nearest `count` of M points to each of N positions.

    Args:
        points: (M, 3).
        positions: (N, 3).
        count: neighbours per position; all M if there are fewer.

    Attributes:
        distance, index: (N, K) of each position's neighbours, nearest first.
        reach: (N,) the distance up to which no point is missing; infinite if all M are listed.
    """

    def __init__(self, points: Floats, positions: Floats, count: int):
        count = min(count, len(points))
        self.distance: Floats = np.zeros((len(positions), count))
        self.index: Ints = np.zeros((len(positions), count), dtype=np.int64)
        if count:
            nearest = np.arange(1, count + 1)
            self.distance, self.index = cKDTree(points).query(positions, k=nearest, workers=-1)
        listed = count < len(points)
        self.reach = self.distance[:, -1] if listed else np.full(len(positions), np.inf)
