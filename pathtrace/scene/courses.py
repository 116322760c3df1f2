"""The courses of what moves: poses in equal steps of time, of shapes and of pieces of what deforms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from compose.camera.camera import Array

# How far a turned vertex may be from the shape at rest, as a share of its diagonal, and points on its faces
# from which that is found: they are closer to each other than that, and so are faces and the ball they make.
_SYMMETRY_TOLERANCE = 0.02
_SYMMETRY_POINTS = 20_000
# Turns that are tried, at most.
_TURNS = 33
# Numbers of pieces that are tried.
_COUNTS = 1, 16, 32, 64, 128, 256
# How far vertices may be from where their piece brings them, as a share of the shape's diagonal: so many
# pieces are used that they are not, as a root mean square over all vertices and times.
_PIECE_TOLERANCE = 3e-3
# Vertices around a piece's centre from which its turn is found.
_NEIGHBOURS = 16


@dataclass(frozen=True)
class Course:
    """Where a shape, or a piece of one that deforms, is over time."""

    name: str  # its id in the scene's file
    shape: int  # its index among the shapes of the scene, which frames have per pixel
    rotations: Array  # (T, 4) unit quaternions (w, x, y, z) from rest, at T equal steps of time from 0 to 1
    centre: Array  # (3,) a point of it at rest, in the coordinates of the frames' cameras
    shifts: Array  # (T, 3) how far that point is from rest

    def as_json(self) -> dict[str, Any]:
        """In types that JSON has."""
        arrays = {name: getattr(self, name).tolist() for name in ("centre", "rotations", "shifts")}
        return {"name": self.name, "shape": self.shape, **arrays}


def course_of_poses(name: str, shape: int, poses: Array, centre: Array) -> Course:
    """A course from (T, 4, 4) rigid transforms from rest."""
    rotations = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return Course(name, shape, rotations, centre, poses[:, :3, :3] @ centre + poses[:, :3, 3] - centre)


def course_from_json(content: dict[str, Any]) -> Course:
    """The course that `as_json` described; KeyError, TypeError or ValueError if there is none."""
    rotations, centre, shifts = (
        np.asarray(content[name], dtype=np.float64) for name in ("rotations", "centre", "shifts")
    )
    steps = len(rotations)
    if steps < 2 or rotations.shape != (steps, 4) or centre.shape != (3,) or shifts.shape != (steps, 3):
        raise ValueError("poses of a course do not fit together")
    if not all(np.isfinite(part).all() for part in (rotations, centre, shifts)):
        raise ValueError("a course that is not finite")
    lengths = np.linalg.norm(rotations, axis=1, keepdims=True)
    if np.abs(lengths - 1).max() > 1e-3:
        raise ValueError("rotations of a course are not unit quaternions")
    return Course(str(content["name"]), int(content["shape"]), rotations / lengths, centre, shifts)


def nearest_rotations(linear: Array) -> Array:
    """(T, 3, 3) the rotations nearest to matrices (T, 3, 3); none is a mirror image (Kabsch 1976)."""
    left, _, right = np.linalg.svd(linear)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return np.asarray(left @ right)


def spread_over_faces(
    vertices: Array, faces: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], Array]:
    """Points that are evenly spread over the faces (F, 3) of a mesh (V, 3), always the same ones.

    They are (N, 3) indices of the vertices around, and shares of these; N is 0 if no face has an area.
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


def is_unchanged(vertices: Array, faces: NDArray[np.int64], centre: Array, rotations: Array) -> bool:
    """Whether a mesh (V, 3) with faces (F, 3) looks the same after turns (T, 3, 3) about a point (3,)."""
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    corners, shares = spread_over_faces(vertices, faces, _SYMMETRY_POINTS)
    tree = cKDTree(np.concatenate([vertices, np.einsum("nc,nci->ni", shares, vertices[corners])]))
    for rotation in rotations[:: max(1, len(rotations) // _TURNS)]:
        turned = (vertices - centre) @ rotation.T + centre
        if tree.query(turned)[0].max() > _SYMMETRY_TOLERANCE * diagonal:
            return False
    return True


def courses_of_pieces(name: str, shape: int, rest: Array, moved: Array) -> list[Course]:
    """Courses of as many pieces as a shape requires whose vertices (V, 3) at rest move (T, V, 3)."""
    diagonal = float(np.linalg.norm(np.ptp(rest, axis=0)))
    for count in _COUNTS:
        centres = _spread(rest, min(count, len(rest)))
        poses = _poses(rest, moved, centres)
        if count >= len(rest) or _error(rest, moved, centres, poses) <= _PIECE_TOLERANCE * diagonal:
            break
    return [course_of_poses(name, shape, *piece) for piece in zip(poses, rest[centres], strict=True)]


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
    poses = np.tile(np.eye(4), (len(centres), len(moved), 1, 1))
    for pose, centre, near_it in zip(poses, centres, near.reshape(len(centres), around), strict=True):
        before, after = rest[near_it] - rest[centre], moved[:, near_it] - moved[:, centre, None]
        pose[:, :3, :3] = nearest_rotations(np.einsum("tni,nj->tij", after, before))
        pose[:, :3, 3] = moved[:, centre] - pose[:, :3, :3] @ rest[centre]
    return poses


def _error(rest: Array, moved: Array, centres: NDArray[np.int64], poses: Array) -> float:
    """Root mean square distance of vertices from where the piece with the nearest centre brings them."""
    _, own = cKDTree(rest[centres]).query(rest)
    squares = []
    for time, vertices in enumerate(moved):
        pose = poses[own, time]
        away = np.einsum("vij,vj->vi", pose[:, :3, :3], rest) + pose[:, :3, 3] - vertices
        squares.append(np.mean((away**2).sum(axis=1)))
    return float(np.sqrt(np.mean(squares)))
