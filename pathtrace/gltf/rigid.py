"""Rigid motion as few keyframes: of what turns and shifts, and keeps its size."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pathtrace.motion.rotations import nearest_rotations
from pathtrace.motion.tracks import Keyframe, RigidTrack

Array = NDArray[np.float64]

# How far a matrix may be from a rotation: that of float32 along a chain of some nodes.
_RIGID = 1e-4
# How far the corners of a shape may be from their way, as a share of its diagonal.
_TOLERANCE = 3e-4
# Between keyframes, radians: half a turn has two shortest ways.
_MOST_TURN = 2.5


def is_rigid(poses: Array) -> bool:
    """Whether (T, 4, 4) transforms keep lengths and mirror nothing."""
    linear = poses[:, :3, :3]
    lengths = np.abs(linear.transpose(0, 2, 1) @ linear - np.eye(3)).max()
    return bool(lengths < _RIGID and (np.linalg.det(linear) > 0).all())


def without_scale(poses: Array) -> Array:
    """(T, 4, 4) rigid transforms that are nearest to given ones: what lights and cameras follow."""
    found = np.tile(np.eye(4), (len(poses), 1, 1))
    found[:, :3, :3], found[:, :3, 3] = nearest_rotations(poses[:, :3, :3]), poses[:, :3, 3]
    return found


def keyframes_of(times: Array, poses: Array, about: Array, corners: Array) -> list[Keyframe]:
    """The fewest keyframes, found greedily, that bring a shape where poses bring it.

    Of a part of the motion that its ends do not explain, the worst moment becomes a keyframe as well
    (Ramer 1972, Douglas and Peucker 1973).

    Args:
        times: (T,) from 0 to 1, ascending.
        poses: (T, 4, 4) rigid transforms from rest.
        about: (3,) the point that the shape turns around.
        corners: (N, 3) points of the shape at rest, which judge.
    """
    keys = [_keyframe(time, pose, about) for time, pose in zip(times, poses, strict=True)]
    wanted = np.einsum("tij,nj->tni", poses[:, :3, :3], corners) + poses[:, None, :3, 3]
    most = _TOLERANCE * float(np.linalg.norm(np.ptp(corners, axis=0)))
    kept, parts = {0, len(keys) - 1}, [(0, len(keys) - 1)]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        track = RigidTrack((keys[first], keys[last]), about=(about[0], about[1], about[2]))
        inner = np.stack([track.pose(times[t]) for t in range(first + 1, last)])
        found = np.einsum("tij,nj->tni", inner[:, :3, :3], corners) + inner[:, None, :3, 3]
        away = np.linalg.norm(found - wanted[first + 1 : last], axis=2).max(axis=1)
        turn = Rotation.from_matrix(poses[last, :3, :3] @ poses[first, :3, :3].T).magnitude()
        if away.max() > most or turn > _MOST_TURN:
            worst = first + 1 + int(np.argmax(away)) if away.max() > most else (first + last) // 2
            kept.add(worst)
            parts += [(first, worst), (worst, last)]
    return [keys[index] for index in sorted(kept)]


def _keyframe(time: float, pose: Array, about: Array) -> Keyframe:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    shift = pose[:3, :3] @ about + pose[:3, 3] - about
    return Keyframe(float(time), (shift[0], shift[1], shift[2]), rotation=(w, x, y, z))


def as_json(keyframes: list[Keyframe], about: Array) -> dict[str, Any]:
    """A track as motion files have it."""
    return {
        "about": about.tolist(),
        "keyframes": [
            {
                "t": key.time,
                "translate": [float(v) for v in key.translate],
                "rotation": list(key.rotation or ()),
            }
            for key in keyframes
        ],
    }
