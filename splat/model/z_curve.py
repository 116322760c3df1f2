"""Sorts points along a space-filling curve."""

from __future__ import annotations

import numpy as np

from splat.model.rows import Floats, Ints

_BITS = 20  # per axis


def z_curve_order(points: Floats) -> Ints:
    """Order (N,) of points (N, 3) along the Z-order curve, which keeps neighbours together (Morton 1966).

    The result does not depend on the order in memory, except among identical points.
    """
    # A training that diverged is rejected elsewhere; its points only need some position here.
    points = np.nan_to_num(points)
    low = points.min(axis=0)
    extent = max(float((points.max(axis=0) - low).max()), 1e-30)
    cell = ((points - low) / extent * (2**_BITS - 1)).astype(np.uint64)
    key = np.zeros(len(points), dtype=np.uint64)
    for bit in range(_BITS):
        for axis in range(3):
            key |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    # Equal keys are sorted by coordinates.
    return np.lexsort((points[:, 2], points[:, 1], points[:, 0], key))
