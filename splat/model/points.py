"""Gaussians as points in space: rows, other coordinates, remoteness, neighbours, order along a curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from compose.camera.coordinate_systems import TYPICAL_DISTANCE, WORLD, Place, place_around
from splat.model.gaussians import Gaussians

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bits = NDArray[np.bool_]


def rows_of(tensor: torch.Tensor) -> Floats:
    """(N, K) float64 rows of a tensor (K, N)."""
    return tensor.detach().numpy().T.astype(np.float64)


def quaternions_xyzw(gaussians: Gaussians) -> Floats:
    """(N, 4) rotations in SciPy's order x, y, z, w, not necessarily of unit length."""
    return rows_of(gaussians.rotations)[:, [1, 2, 3, 0]]


# Sizes of sets of Gaussians that float32 and the rasterizer's near plane are made for, and how many sizes
# away from the world's origin they may lie.
_LEAST_SIZE, _LARGEST_SIZE, _FARTHEST = 0.1, 1e5, 1e3


def in_world(own: Gaussians, place: Place) -> Gaussians:
    """Gaussians of a place in world space: as exact as float32 is there."""
    return _mapped(own, np.array(place.origin), place.unit)


def from_world(world: Gaussians, place: Place) -> Gaussians:
    """Gaussians of the world in the coordinates of a place."""
    return _mapped(world, -np.array(place.origin) / place.unit, 1 / place.unit)


def place_of_gaussians(world: Gaussians) -> Place:
    """The place for Gaussians of which no views are known; the world itself where that is good enough."""
    means = rows_of(world.means)
    middle = np.median(means, axis=0)
    size = float(np.median(np.linalg.norm(means - middle, axis=1)))
    near = np.linalg.norm(middle) <= _FARTHEST * size
    # A single Gaussian, or many in one point, have no size.
    good = size == 0 or (near and _LEAST_SIZE <= size <= _LARGEST_SIZE)
    return WORLD if good else place_around(means, size)


def _mapped(gaussians: Gaussians, offset: NDArray[np.float64], scale: float) -> Gaussians:
    """The Gaussians scaled, then moved; computed in float64, and differentiable."""
    means = gaussians.means.double() * scale + torch.from_numpy(offset).to(gaussians.means.device)[:, None]
    log_scales = gaussians.log_scales.double() + float(np.log(scale))
    return replace(gaussians, means=means.float(), log_scales=log_scales.float())


# In units of a place. What is nearer counts as typical, since views differ in how far away it is from them.
_FAR_AWAY = 32 * TYPICAL_DISTANCE


def remoteness(means: torch.Tensor) -> torch.Tensor:
    """(N,) distance of centres (3, N) from the origin of their place over the typical one; 1 unless far."""
    distance = torch.linalg.vector_norm(means.detach(), dim=0)
    return torch.where(distance > _FAR_AWAY, distance / TYPICAL_DISTANCE, 1.0)


class Neighbours:
    """The nearest `count` of M points (M, 3), or all if there are fewer, to each of N positions (N, 3)."""

    def __init__(self, points: Floats, positions: Floats, count: int):
        count = min(count, len(points))
        # (N, K) of each position's neighbours, nearest first.
        self.distance: Floats = np.zeros((len(positions), count))
        self.index: Ints = np.zeros((len(positions), count), dtype=np.int64)
        if count:
            nearest = np.arange(1, count + 1)
            self.distance, self.index = cKDTree(points).query(positions, k=nearest, workers=-1)
        # (N,) the distance up to which no point is missing; infinite if all M are listed.
        some = count < len(points)
        self.reach = self.distance[:, -1] if some else np.full(len(positions), np.inf)


_BITS = 20  # per axis
# Points more than this many median distances from the middle are drawn in, or all others would share few
# cells.
_FAR = 64.0
# Squares of what is longer leave the range of numbers.
_LARGEST = 1e150


def z_curve_order(points: Floats) -> Ints:
    """Order (N,) of points (N, 3) along the Z-order curve, which keeps neighbours together (Morton 1966).

    The result does not depend on the order in memory, except among identical points.
    """
    # A training that diverged is rejected elsewhere; its points only need some position here.
    points = np.clip(np.nan_to_num(points), -_LARGEST, _LARGEST)
    middle = np.median(points, axis=0)
    reach = _FAR * float(np.median(np.linalg.norm(points - middle, axis=1)))
    points = drawn_in(points, middle, reach)
    # Equal keys are sorted by coordinates.
    return np.lexsort((points[:, 2], points[:, 1], points[:, 0], z_curve_keys(points, _BITS)))


def z_curve_keys(points: Floats, bits: int) -> NDArray[np.uint64]:
    """(N,) positions of points (N, 3) along the Z-order curve, in cells of `bits` per axis."""
    low = points.min(axis=0)
    extent = max(float((points.max(axis=0) - low).max()), 1e-30)
    cell = ((points - low) / extent * (2**bits - 1)).astype(np.uint64)
    key = np.zeros(len(points), dtype=np.uint64)
    for bit in range(bits):
        for axis in range(3):
            key |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return key


def drawn_in(points: Floats, middle: Floats, reach: float) -> Floats:
    """Points (N, 3); those beyond a reach around the middle (3,) at the logarithm of their distance."""
    away = points - middle
    distance = np.linalg.norm(away, axis=1)
    beyond = distance > reach
    if reach == 0 or not beyond.any():
        return points
    nearer = reach * (1 + np.log(distance[beyond] / reach)) / distance[beyond]
    points = points.copy()
    points[beyond] += (nearer - 1)[:, None] * away[beyond]
    return points
