"""What deforms, as pieces that move nearly rigidly."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pathtrace.motion.course import Array, Course, course_of_poses
from pathtrace.motion.rotations import nearest_rotations

# Numbers of pieces that are tried.
_COUNTS = 1, 16, 32, 64, 128, 256
# How far vertices may be from where their piece brings them, as a share of the shape's diagonal: so many
# pieces are used that they are not, as a root mean square over all vertices and times.
_TOLERANCE = 3e-3
# Vertices around a piece's centre from which its turn is found.
_NEIGHBOURS = 16


def courses_of_pieces(name: str, shape: int, rest: Array, moved: Array) -> list[Course]:
    """The courses of as many pieces as a deforming shape requires.

    Args:
        name, shape: as of `Course`.
        rest: (V, 3) vertices at rest.
        moved: (T, V, 3) the same at T equal steps of time from 0 to 1.
    """
    diagonal = float(np.linalg.norm(np.ptp(rest, axis=0)))
    for count in _COUNTS:
        centres = _spread(rest, min(count, len(rest)))
        poses = _poses(rest, moved, centres)
        if count >= len(rest) or _error(rest, moved, centres, poses) <= _TOLERANCE * diagonal:
            break
    return [
        course_of_poses(name, shape, piece, rest[centre])
        for centre, piece in zip(centres, poses, strict=True)
    ]


def _spread(points: Array, count: int) -> NDArray[np.int64]:
    """(count,) indices of points (V, 3) that are far from each other: each the farthest from those before."""
    chosen = [int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    away = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def _poses(rest: Array, moved: Array, centres: NDArray[np.int64]) -> Array:
    """(P, T, 4, 4) the rigid transforms of pieces: those of the vertices around their centres.

    A single piece is the whole shape. Turns are those of Kabsch (1976), and a centre stays where it is.
    """
    around = len(rest) if len(centres) == 1 else min(_NEIGHBOURS, len(rest))
    _, near = cKDTree(rest).query(rest[centres], k=around)
    near = near.reshape(len(centres), around)
    pairs = zip(centres, near, strict=True)
    return np.stack([_piece(rest[n], moved[:, n], rest[c], moved[:, c]) for c, n in pairs])


def _piece(rest: Array, moved: Array, centre: Array, centre_moved: Array) -> Array:
    """(T, 4, 4) the transform of vertices (N, 3) to (T, N, 3) that brings a centre (3,) to (T, 3)."""
    before, after = rest - centre, moved - centre_moved[:, None]
    poses = np.tile(np.eye(4), (len(moved), 1, 1))
    poses[:, :3, :3] = nearest_rotations(np.einsum("tni,nj->tij", after, before))
    poses[:, :3, 3] = centre_moved - poses[:, :3, :3] @ centre
    return poses


def _error(rest: Array, moved: Array, centres: NDArray[np.int64], poses: Array) -> float:
    """Root mean square distance of vertices from where the piece with the nearest centre brings them."""
    _, own = cKDTree(rest[centres]).query(rest)
    squares = [np.mean(part) for part in _squares(rest, moved, own, poses)]
    return float(np.sqrt(np.mean(squares)))


def _squares(rest: Array, moved: Array, own: NDArray[np.int64], poses: Array) -> Iterator[Array]:
    """(V,) squared distances at each time."""
    for time, vertices in enumerate(moved):
        pose = poses[own, time]
        yield ((np.einsum("vij,vj->vi", pose[:, :3, :3], rest) + pose[:, :3, 3] - vertices) ** 2).sum(axis=1)
