"""Tells the objects apart whose pixels move, where no mask does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from splat.separation.observation import Observation

# Points of what moves, about, from which objects are made.
_POINTS = 8000
# Distance up to which two points at the same time are of one object, in units of the median distance of what
# moves; a step from one frame to the next, in the order of their times, counts as half of that.
_NEAR = 0.06
# Share of all moving points from which on they are an object of their own; fewer belong to the nearest one.
_LEAST = 0.02


def objects_of(
    observations: Sequence[Observation], moving: Sequence[NDArray[np.bool_]]
) -> list[NDArray[np.int32]]:
    """(H, W) for each frame, which object a pixel shows, from 0; -1 for what stands still.

    Points are of one object if they are near each other in space and in time, or if others lead from one to
    the other. Objects that touch are one. They are numbered by how much of them is seen, most first.

    Args:
        observations: frames of one scene.
        moving: (H, W) for each frame, which pixels show something that moves.
    """
    shown = [
        mask & np.isfinite(one.distance) & (one.distance > 0)
        for one, mask in zip(observations, moving, strict=True)
    ]
    clouds = _clouds(observations, shown)
    every = max(1, sum(map(len, clouds)) // _POINTS)
    sampled = np.concatenate([cloud[::every] for cloud in clouds]) if clouds else np.zeros((0, 4))
    if not len(sampled):
        return [np.full(mask.shape, -1, dtype=np.int32) for mask in moving]
    number = _numbers(sampled)
    tree = cKDTree(sampled)
    found = []
    for cloud, mask in zip(clouds, shown, strict=True):
        labels = np.full(mask.shape, -1, dtype=np.int32)
        labels[mask] = number[tree.query(cloud)[1]] if len(cloud) else 0
        found.append(labels)
    return found


def _clouds(
    observations: Sequence[Observation], shown: Sequence[NDArray[np.bool_]]
) -> list[NDArray[np.float64]]:
    """For each frame (M, 4) the points of what moves, and when, in units of how far apart points may be."""
    distances = [one.distance[mask] for one, mask in zip(observations, shown, strict=True)]
    near = _NEAR * float(np.median(np.concatenate(distances))) if sum(map(len, distances)) else 1.0
    times = sorted({one.time for one in observations})
    order = {time: 0.5 * step for step, time in enumerate(times)}
    return [
        np.concatenate([one.points()[mask] / near, np.full((int(mask.sum()), 1), order[one.time])], axis=1)
        for one, mask in zip(observations, shown, strict=True)
    ]


def _numbers(points: NDArray[np.float64]) -> NDArray[np.int32]:
    """(N,) object of each point (N, 4), by links of length 1 at most."""
    pairs = cKDTree(points).query_pairs(1.0, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    _, part = connected_components(links, directed=False)
    size = np.bincount(part)
    large = np.flatnonzero(size >= max(_LEAST * len(points), 1))
    large = large[np.argsort(-size[large], kind="stable")] if len(large) else np.array([size.argmax()])
    rank = np.full(len(size), -1, dtype=np.int32)
    rank[large] = np.arange(len(large))
    number = rank[part]
    rest = number < 0
    if rest.any():
        nearest = cKDTree(points[~rest]).query(points[rest])[1]
        number[rest] = number[~rest][nearest]
    return number
