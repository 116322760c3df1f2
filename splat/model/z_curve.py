"""Sorts points along a space-filling curve."""

from __future__ import annotations

import numpy as np

from splat.model.rows import Floats, Ints

_BITS = 20  # per axis
# Points more than this many times the median distance away from the middle, such as the sky's, are drawn in:
# otherwise all others would share the few cells in the middle of them.
_FAR = 64.0
# Squares of what is longer leave the range of numbers.
_LARGEST = 1e150


def z_curve_order(points: Floats) -> Ints:
    """Order (N,) of points (N, 3) along the Z-order curve, which keeps neighbours together (Morton 1966).

    The result does not depend on the order in memory, except among identical points.
    """
    # A training that diverged is rejected elsewhere; its points only need some position here.
    points = _drawn_in(np.clip(np.nan_to_num(points), -_LARGEST, _LARGEST))
    low = points.min(axis=0)
    extent = max(float((points.max(axis=0) - low).max()), 1e-30)
    cell = ((points - low) / extent * (2**_BITS - 1)).astype(np.uint64)
    key = np.zeros(len(points), dtype=np.uint64)
    for bit in range(_BITS):
        for axis in range(3):
            key |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    # Equal keys are sorted by coordinates.
    return np.lexsort((points[:, 2], points[:, 1], points[:, 0], key))


def _drawn_in(points: Floats) -> Floats:
    """Points (N, 3), those that are far away from most at the logarithm of their distance."""
    away = points - np.median(points, axis=0)
    distance = np.linalg.norm(away, axis=1)
    reach = _FAR * np.median(distance)
    far = distance > reach
    if reach == 0 or not far.any():
        return points
    nearer = reach * (1 + np.log(distance[far] / reach)) / distance[far]
    points = points.copy()
    points[far] += (nearer - 1)[:, None] * away[far]
    return points
