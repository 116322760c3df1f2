"""Points in order along a space-filling curve."""

from __future__ import annotations

import numpy as np

from splat.model.rows import Floats, Ints


def z_curve_order(points: Floats) -> Ints:
    """Order (N,) in which neighbours in space mostly follow each other (Morton 1966)."""
    # A training gone wrong is refused elsewhere; here its points only need some place.
    points = np.nan_to_num(points)
    low = points.min(axis=0)
    extent = max(float((points.max(axis=0) - low).max()), 1e-30)
    cell = ((points - low) / extent * (2**20 - 1)).astype(np.uint64)
    key = np.zeros(len(points), dtype=np.uint64)
    for bit in range(20):
        for axis in range(3):
            key |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    # Equal keys in the order of the coordinates, so that the order in memory does not matter.
    return np.lexsort((points[:, 2], points[:, 1], points[:, 0], key))
