"""How each part of a glTF scene moves: not at all, rigidly in few keyframes, or from mesh to mesh."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from compose.base.errors import UserError
from compose.camera.camera import Array
from pathtrace.gltf.animated_nodes import Nodes
from pathtrace.gltf.meshes import Primitive
from pathtrace.scene.courses import nearest_rotations
from pathtrace.scene.motion_file import Keyframe, RigidTrack

# How far a matrix may be from a rotation: that of float32 along a chain of some nodes.
_RIGID = 1e-4
# How far the corners of a shape may be from their way, as a share of its diagonal.
_TOLERANCE = 3e-4
# Between keyframes, radians: half a turn has two shortest ways.
_MOST_TURN = 2.5
# Of a shape's diagonal: less is rounding.
_STILL = 1e-6
# Of all mesh files together; that many take some gigabytes.
_MOST_VERTICES = 100_000_000
# Of all nodes at all times, a matrix of 128 bytes each.
_MOST_POSES = 5_000_000
# Squares of what is farther from the origin overflow float32.
_LARGEST = 1e18
# Of the whole time, between what is before a step and what is after it.
_STEP = 1e-6
# Determinant of what has no volume.
_FLAT = 1e-12


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

    Of a part of the motion that its ends do not explain, the worst moment becomes a keyframe (Ramer 1972,
    Douglas and Peucker 1973). Poses (T, 4, 4) are rigid transforms from rest at ascending times (T,) from 0
    to 1; the shape turns about a point (3,), and the ways of its corners (N, 3) at rest are compared.
    """
    keys = [_keyframe(time, pose, about) for time, pose in zip(times, poses, strict=True)]
    wanted = _moved(poses, corners)
    most = _TOLERANCE * float(np.linalg.norm(np.ptp(corners, axis=0)))
    kept, parts = {0, len(keys) - 1}, [(0, len(keys) - 1)]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        track = RigidTrack((keys[first], keys[last]), about=(about[0], about[1], about[2]))
        inner = np.stack([track.pose(times[t]) for t in range(first + 1, last)])
        away = np.linalg.norm(_moved(inner, corners) - wanted[first + 1 : last], axis=2).max(axis=1)
        turn = Rotation.from_matrix(poses[last, :3, :3] @ poses[first, :3, :3].T).magnitude()
        if away.max() > most or turn > _MOST_TURN:
            worst = first + 1 + int(np.argmax(away)) if away.max() > most else (first + last) // 2
            kept.add(worst)
            parts += [(first, worst), (worst, last)]
    return [keys[index] for index in sorted(kept)]


def _moved(poses: Array, points: Array) -> Array:
    """(T, N, 3) where poses (T, 4, 4) bring points (N, 3)."""
    return np.asarray(np.einsum("tij,nj->tni", poses[:, :3, :3], points) + poses[:, None, :3, 3])


def _keyframe(time: float, pose: Array, about: Array) -> Keyframe:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    shift = pose[:3, :3] @ about + pose[:3, 3] - about
    return Keyframe(float(time), (shift[0], shift[1], shift[2]), rotation=(w, x, y, z))


def as_json(keyframes: list[Keyframe], about: Array) -> dict[str, Any]:
    """A track as motion files have it."""
    keys = [
        {"t": key.time, "translate": [*map(float, key.translate)], "rotation": list(key.rotation or ())}
        for key in keyframes
    ]
    return {"about": about.tolist(), "keyframes": keys}


@dataclass(frozen=True)
class Movement:
    """Where a primitive is over time."""

    rest: Array  # (V, 3) its vertices in the world at time 0
    bounds: Array  # (2, 3) lowest and highest corner at any time
    about: Array  # (3,) the point that it turns around
    keyframes: list[Keyframe]  # of its rigid motion; empty if there is none
    meshes: Array  # (T, V, 3) at equal steps of time, of what deforms; else T is 0


class Times:
    """When nodes are looked at, in seconds: at even (E,) and, with keyframes and steps, dense (T,) times.

    Shares (T,) of the dense ones are from 0 to 1. UserError if they are too many.
    """

    def __init__(self, nodes: Nodes, fps: float):
        seconds = nodes.animation.seconds
        if seconds * fps * len(nodes) > _MOST_POSES:
            raise UserError(
                f"fps {fps:g}: an animation of {seconds:,.0f} s and {len(nodes):,} nodes is too long"
            )
        # At least so many a second.
        self.even = np.linspace(0, seconds, max(int(np.ceil(seconds * fps - 1e-6)), 1) + 1)
        found = [self.even]
        for sampler in nodes.animation.channels.values():
            found.append(sampler.times)
            if sampler.interpolation == "STEP":
                found.append(sampler.times[1:] - _STEP * seconds)
        times = np.unique(np.concatenate(found))
        times = times[times >= 0]
        # Those that are closer are the same but for rounding, and keyframes must ascend.
        self.dense = times[np.diff(times, prepend=-np.inf) > 0.1 * _STEP * seconds]
        self.shares = self.dense / max(float(self.dense[-1]), 1e-30)


def movement_of(primitive: Primitive, nodes: Nodes, times: Times, to_world: list[Array]) -> Movement:
    """How a primitive moves; `to_world` is (T, 4, 4) or (1, 4, 4) of each node, at the dense times."""
    (rest,) = primitive.vertices(nodes, times.dense[:1])
    poses = to_world[primitive.node]
    about, none = poses[0, :3, 3], np.zeros((0, *rest.shape))
    still = Movement(rest, _bounds(rest), about, [], none)
    if deforms(primitive, nodes, to_world):
        meshes = np.stack(list(primitive.vertices(nodes, times.even)))
        if _is_still(meshes, rest):
            return still
        return Movement(rest, _bounds(meshes.reshape(-1, 3)), about, [], meshes)
    if len(poses) == 1:
        return still
    corners, from_rest = np.array(list(product(*still.bounds.T))), poses @ np.linalg.inv(poses[0])
    moved = _moved(from_rest, corners)
    if _is_still(moved, corners):
        return still
    # What turns around one of them turns in fewer keyframes, and elsewhere goes along arcs.
    centres = [to_world[node][0, :3, 3] for node in nodes.ancestors(primitive.node)]
    ways = [keyframes_of(times.shares, from_rest, centre, corners) for centre in centres]
    centre, best = min(zip(centres, ways, strict=True), key=lambda found: len(found[1]))
    return Movement(rest, _bounds(moved.reshape(-1, 3)), centre, best, none)


def deforms(primitive: Primitive, nodes: Nodes, to_world: list[Array]) -> bool:
    """Whether a primitive moves by more than turns and shifts; `to_world` as in `movement_of`."""
    if primitive.skin is not None or (primitive.node, "weights") in nodes.animation.channels:
        return True
    poses = to_world[primitive.node]
    if len(poses) == 1:
        return False
    # Nothing that is flat at rest is brought back by turning it.
    return abs(np.linalg.det(poses[0, :3, :3])) < _FLAT or not is_rigid(poses @ np.linalg.inv(poses[0]))


def require_few(primitives: list[Primitive], nodes: Nodes, times: Times, to_world: list[Array]) -> None:
    """UserError for more sequences of meshes than a disk or memory should hold."""
    steps = len(times.even)
    vertices = steps * sum(len(p.positions) for p in primitives if deforms(p, nodes, to_world))
    if vertices > _MOST_VERTICES:
        raise UserError(
            f"fps: what deforms would have {vertices:,} vertices in {steps:,} steps of time; "
            f"must be at most {_MOST_VERTICES:,}"
        )


def _is_still(moved: Array, rest: Array) -> bool:
    return bool(np.abs(moved - rest).max() <= _STILL * np.ptp(rest, axis=0).max())


def _bounds(points: Array) -> Array:
    """(2, 3) lowest and highest corner; ValueError if float32 does not hold them."""
    if not np.abs(points).max() < _LARGEST:
        raise ValueError("vertices are too far from the origin")
    return np.stack([points.min(axis=0), points.max(axis=0)])
