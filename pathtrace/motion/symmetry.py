"""Turns that leave a shape as it is: nobody sees them on what has no texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pathtrace.motion.course import Array
from pathtrace.motion.faces import spread_over_faces

# How far a turned vertex may be from the shape at rest, as a share of its diagonal, and points on its faces
# from which that is found: they are closer to each other than that, and so are faces and the ball they make.
_TOLERANCE = 0.02
_POINTS = 20_000
# Turns that are tried, at most.
_TURNS = 33


def is_unchanged(vertices: Array, faces: NDArray[np.int64], centre: Array, rotations: Array) -> bool:
    """Whether a mesh looks the same after turns around a point.

    Args:
        vertices: (V, 3) at rest.
        faces: (F, 3) indices of vertices.
        centre: (3,) that is turned around.
        rotations: (T, 3, 3).
    """
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    tree = cKDTree(np.concatenate([vertices, _on_faces(vertices, faces)]))
    for rotation in rotations[:: max(1, len(rotations) // _TURNS)]:
        turned = (vertices - centre) @ rotation.T + centre
        if tree.query(turned)[0].max() > _TOLERANCE * diagonal:
            return False
    return True


def _on_faces(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """(N, 3) points that are evenly spread over the faces."""
    corners, shares = spread_over_faces(vertices, faces, _POINTS)
    return np.einsum("nc,nci->ni", shares, vertices[corners])
