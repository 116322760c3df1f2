"""Points on the faces of a mesh, which go where its vertices take them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pathtrace.motion.course import Array


def spread_over_faces(
    vertices: Array, faces: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], Array]:
    """Points that are evenly spread over the faces of a mesh, always the same ones.

    Args:
        vertices: (V, 3).
        faces: (F, 3) indices of vertices.
        count: number of points; there are none on faces without an area.

    Returns:
        (N, 3) indices of the vertices around each point, and (N, 3) its shares of them, whose sum is 1.
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not areas.sum():
        return np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3))
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(faces), count, p=areas / areas.sum())
    u, v = rng.random((2, count))
    root = np.sqrt(u)
    return faces[chosen], np.stack([1 - root, root * (1 - v), root * v], axis=1)
