"""Many views at once, as arrays: where viewers stand, how they look and what they see."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Array, Camera
from pathtrace.scene.triangles import Surfaces

# Up is an axis of the world if that of the camera leans by less than about 50 degrees from it.
_UPRIGHT = 0.65


@dataclass(frozen=True)
class Looks:
    """Views: positions (N, 3) in the world, and (N, 3, 3) camera-to-world rotations, OpenCV axes."""

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
        return like.at(pose)

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

    Yaw (N,) is in degrees about the unit vector `up` (3,), pitch (N,) in degrees above the horizon.
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
    return replace(camera.at(camera.camera_to_world), fx=camera.fx * scale, fy=camera.fy * scale)
