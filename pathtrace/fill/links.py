"""What rays from points have found, as links between cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from pathtrace.cache.cells import Cells, Points
from pathtrace.cache.transport import Links
from pathtrace.fill.gather import Seen

# Points that are looked at to find a near one, at most.
_CANDIDATES = 1 << 16
# Distance, in units of the cells' scale, that counts as much as an angle of 60 degrees between normals.
_TURNED = 0.1


def cells_hit(seen: Seen, points: Points, cells: Cells) -> NDArray[np.int64]:
    """(M,) cell that each ray hit; -1 where it left the scene, or if there is no cell.

    Where a ray hit no cell, since nothing is known there or something divides the cell, the cell of the
    nearest point that faces the same way stands for it. Without these rays the mean of the others would
    stand for them, although they often hit what is darker: corners, and what lies behind things.

    Args:
        seen: what the rays found.
        points: that lie in the cells.
        cells: known by these points.
    """
    hit = np.where(seen.valid, cells.smallest(seen.hits), -1)
    lost = np.flatnonzero(seen.valid & (hit < 0))
    if not len(lost):
        return hit
    candidates = points.take(np.arange(0, len(points), -(-len(points) // _CANDIDATES)))
    own = cells.smallest(candidates)
    if (own < 0).all():
        return hit
    scale = np.float32(cells.grid.scale)
    place = lambda some: np.hstack([some.position / scale, np.float32(_TURNED) * some.normal])  # noqa: E731
    tree = KDTree(place(candidates.take(own >= 0)), balanced_tree=False, compact_nodes=False)
    _, nearest = tree.query(place(seen.hits.take(lost)))
    hit[lost] = own[own >= 0][nearest]
    return hit


def links_of(seen: Seen, cell: NDArray[np.int64], weight: NDArray[np.float32]) -> Links:
    """The links of rays.

    Args:
        seen: what the rays found.
        cell: (M,) that each hit, of `cells_hit`.
        weight: (M,) of each ray in the mean of those of its point.
    """
    # Without any cell, nothing can be said of the rays that hit something.
    kept = np.flatnonzero(~seen.valid | (cell >= 0))
    reflectance = weight[kept, None] * seen.reflectance[kept]
    return Links(seen.point[kept], cell[kept], seen.bounces[kept], reflectance)
