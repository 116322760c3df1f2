"""Many views at once, as arrays: where viewers stand, how they look, what they see, and draws at random."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Array, Camera, camera_from_pose
from pathtrace.scene.triangles import Surfaces

# Up is an axis of the world if that of the camera leans by less than about 50 degrees from it.
_UPRIGHT = 0.65


@dataclass(frozen=True)
class Looks:
    """Views.

    Attributes:
        positions: (N, 3) in world space.
        rotations: (N, 3, 3) camera-to-world, OpenCV axes.
    """

    positions: Array
    rotations: Array

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, chosen: NDArray[np.generic] | slice) -> Looks:
        return Looks(self.positions[chosen], self.rotations[chosen])

    def camera(self, index: int, like: Camera) -> Camera:
        """One of the views as a camera with the intrinsics of another one."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotations[index], self.positions[index]
        return camera_from_pose(pose, like.width, like.height, like.fx, like.fy, like.cx, like.cy)

    def rays(self, like: Camera, side: int) -> tuple[Array, Array]:
        """Origins and directions, (N * side * side, 3) each, over a coarse grid of each frame."""
        x, y = np.meshgrid(*[(np.arange(side) + 0.5) / side] * 2)
        local = np.stack(
            [
                (x.ravel() * like.width - like.cx) / like.fx,
                (y.ravel() * like.height - like.cy) / like.fy,
                np.ones(side * side),
            ],
            axis=1,
        )
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        directions = np.einsum("nij,mj->nmi", self.rotations, local).reshape(-1, 3)
        return np.repeat(self.positions, side * side, axis=0), directions

    def probe(self, surfaces: Surfaces, like: Camera, side: int) -> Array:
        """(N, side * side) distances to what the views see; inf where there is nothing."""
        return surfaces.distance(*self.rays(like, side)).reshape(len(self), side * side)


def looks_of(cameras: list[Camera]) -> Looks:
    """Cameras as arrays, without their intrinsics."""
    poses = np.array([camera.camera_to_world for camera in cameras]).reshape(-1, 4, 4)
    return Looks(poses[:, :3, 3], poses[:, :3, :3])


def upright(home: Camera) -> Array:
    """(3,) what is up: the axis of the world that is nearest to the camera's own, else the camera's own."""
    own = -home.camera_to_world[:3, 1]
    axis = int(np.argmax(np.abs(own)))
    return np.sign(own[axis]) * np.eye(3)[axis] if abs(own[axis]) > _UPRIGHT else own


def turned_about(up: Array, yaw: Array, pitch: Array) -> Array:
    """(N, 3, 3) camera-to-world rotations with a level horizon.

    Args:
        up: (3,) unit vector.
        yaw: (N,) degrees about it, from any fixed direction.
        pitch: (N,) degrees above the horizon.
    """
    level = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    level /= np.linalg.norm(level)
    yaw, pitch = np.radians(yaw)[:, None], np.radians(pitch)[:, None]
    ahead = np.cos(yaw) * level + np.sin(yaw) * np.cross(up, level)
    forward = np.cos(pitch) * ahead + np.sin(pitch) * up
    right = np.cross(ahead, up)
    return np.stack([right, np.cross(forward, right), forward], axis=2)


def widened(camera: Camera, degrees: float) -> Camera:
    """The camera with a field of view of at least that many degrees along the frame's shorter side."""
    least = 0.5 / np.tan(np.radians(degrees) / 2)
    scale = min(1.0, least * min(camera.width, camera.height) / max(camera.fx, camera.fy))
    pose = camera.camera_to_world
    return camera_from_pose(
        pose, camera.width, camera.height, camera.fx * scale, camera.fy * scale, camera.cx, camera.cy
    )


# Side of the coarse frames that say what a view shows.
_SIDE = 12
# Largest share of a frame with surfaces that are too near, and smallest with any surface at all.
_NEAR_SHARE, _SEEN_SHARE = 0.1, 0.3
_TRIES = 24
# Streams of random numbers: what is trained on must not be what is judged.
TRAINING, JUDGING, VIEWING = 0, 1, 2


def generator(seed: int, stream: int, number: int = 0) -> np.random.Generator:
    """Random numbers of a stream; `number` tells its parts apart."""
    return np.random.default_rng([seed, stream, number])


def drawn(
    count: int, propose: Callable[[int], Looks], surfaces: Surfaces, like: Camera, near: float
) -> Looks:
    """Up to `count` views that show something, and not only from too near.

    Args:
        count: of views.
        propose: gives that many views.
        surfaces: of the scene.
        like: camera that has the views' intrinsics.
        near: surfaces nearer than this are too near to look at.

    Returns:
        Fewer views, or none, where hardly one in 24 shows anything.
    """
    positions, rotations, total = [], [], 0
    for _ in range(_TRIES):
        looks = propose(count)
        looks = looks[_shows(looks, surfaces, like, near)]
        positions.append(looks.positions)
        rotations.append(looks.rotations)
        total += len(looks)
        if total >= count:
            break
    return Looks(np.concatenate(positions)[:count], np.concatenate(rotations)[:count])


def _shows(looks: Looks, surfaces: Surfaces, like: Camera, near: float) -> NDArray[np.bool_]:
    distance = looks.probe(surfaces, like, _SIDE)
    too_near = np.mean(distance < near, axis=1)
    seen = np.mean(np.isfinite(distance), axis=1)
    return (too_near <= _NEAR_SHARE) & (seen >= _SEEN_SHARE)
