"""How each part of a glTF scene moves: not at all, rigidly, or from mesh to mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from pathtrace.gltf.nodes import Nodes
from pathtrace.gltf.primitives import Primitive
from pathtrace.gltf.rigid import is_rigid, keyframes_of
from pathtrace.motion.tracks import Keyframe

Array = NDArray[np.float64]

# Of a shape's diagonal: less is rounding.
_STILL = 1e-6
# Of all mesh files together; that many take some gigabytes.
_MOST_VERTICES = 100_000_000
# Of all nodes at all times, a matrix of 128 bytes each.
_MOST_POSES = 5_000_000
# Squares of what is farther from the origin overflow float32.
_LARGEST = 1e18
# Determinant of what has no volume.
_FLAT = 1e-12


@dataclass(frozen=True)
class Movement:
    """Where a primitive is over time.

    Attributes:
        rest: (V, 3) its vertices in the world at time 0.
        bounds: (2, 3) lowest and highest corner at any time.
        about: (3,) the point that it turns around.
        keyframes: of its rigid motion; empty if there is none.
        meshes: (T, V, 3) at equal steps of time, of what deforms; else T is 0.
    """

    rest: Array
    bounds: Array
    about: Array
    keyframes: list[Keyframe]
    meshes: Array


@dataclass(frozen=True)
class Times:
    """When a scene is looked at, in seconds.

    Attributes:
        dense: (T,) equal steps, all keyframes and moments before steps.
        even: (E,) equal steps.
    """

    dense: Array
    even: Array

    @property
    def shares(self) -> Array:
        """(T,) the dense ones, from 0 to 1."""
        return self.dense / max(float(self.dense[-1]), 1e-30)


def times_of(nodes: Nodes, fps: float) -> Times:
    """When to look at nodes while their animation plays.

    Raises:
        UserError: that is too often.
    """
    seconds = nodes.animation.seconds
    if seconds * fps * len(nodes) > _MOST_POSES:
        raise UserError(
            f"--fps {fps:g}: an animation of {seconds:,.0f} s and {len(nodes):,} nodes is too long"
        )
    return Times(nodes.animation.all_times(fps), nodes.animation.even_times(fps))


def movement_of(primitive: Primitive, nodes: Nodes, times: Times, to_world: list[Array]) -> Movement:
    """How a primitive moves.

    Args:
        primitive: it.
        nodes: of its file.
        times: to look at.
        to_world: (T, 4, 4) or (1, 4, 4) of each node, at the dense times.
    """
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
    corners, from_rest = _corners(_bounds(rest)), poses @ np.linalg.inv(poses[0])
    moved = np.einsum("tij,nj->tni", from_rest[:, :3, :3], corners) + from_rest[:, None, :3, 3]
    if _is_still(moved, corners):
        return still
    # What turns around one of them turns in fewer keyframes, and elsewhere goes along arcs.
    centres = [to_world[node][0, :3, 3] for node in nodes.ancestors(primitive.node)]
    ways = [keyframes_of(times.shares, from_rest, centre, corners) for centre in centres]
    best = min(range(len(ways)), key=lambda way: len(ways[way]))
    return Movement(rest, _bounds(moved.reshape(-1, 3)), centres[best], ways[best], none)


def deforms(primitive: Primitive, nodes: Nodes, to_world: list[Array]) -> bool:
    """Whether a primitive moves by more than turns and shifts; `to_world` as of `movement_of`."""
    if primitive.skin is not None or (primitive.node, "weights") in nodes.animation.channels:
        return True
    poses = to_world[primitive.node]
    if len(poses) == 1:
        return False
    # Nothing that is flat at rest is brought back by turning it.
    return abs(np.linalg.det(poses[0, :3, :3])) < _FLAT or not is_rigid(poses @ np.linalg.inv(poses[0]))


def require_few(primitives: list[Primitive], nodes: Nodes, times: Times, to_world: list[Array]) -> None:
    """Refuses sequences of meshes that no disk and no memory should hold.

    Raises:
        UserError: there would be too many.
    """
    steps = len(times.even)
    vertices = steps * sum(len(p.positions) for p in primitives if deforms(p, nodes, to_world))
    if vertices > _MOST_VERTICES:
        raise UserError(
            f"--fps: what deforms would have {vertices:,} vertices in {steps:,} steps of time; "
            f"must be at most {_MOST_VERTICES:,}"
        )


def _is_still(moved: Array, rest: Array) -> bool:
    return bool(np.abs(moved - rest).max() <= _STILL * np.ptp(rest, axis=0).max())


def _bounds(points: Array) -> Array:
    """(2, 3) lowest and highest corner; ValueError if float32 does not hold them."""
    if not np.abs(points).max() < _LARGEST:
        raise ValueError("vertices are too far from the origin")
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _corners(bounds: Array) -> Array:
    """(8, 3) of a box."""
    return np.stack([bounds[[x, y, z], [0, 1, 2]] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
