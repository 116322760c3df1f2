"""Pinhole cameras: what they see, at which time, turned as a viewer looks around, and for two eyes.

The world is right-handed. A camera is a 4x4 world-to-camera matrix in OpenCV axes (x right, y down, z
forward) with intrinsics in pixels. Pixel centres lie at +0.5, rows count from the top.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# By how much axes may differ from unit length: files of other programs hold float32 or five digits.
RIGID_TOLERANCE = 1e-4
# Least sine of the angle between a direction of sight and what is up: less is rounding.
_LEAST_SINE = 1e-12
EYES = ("left", "right")


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera; equal to another one if every number is the same.

    Attributes:
        world_to_camera: (4, 4) rigid transform, OpenCV axes.
        width, height: frame size in pixels.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels, (width / 2, height / 2) for a centred camera.

    Raises:
        ValueError: a size or a focal length is not positive, a number is not finite, or the transform is not
            rigid to a ten-thousandth: it scales, shears or mirrors, or its last row is not 0 0 0 1.
    """

    world_to_camera: Array
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise ValueError(f"frame size {self.width} x {self.height} must be positive")
        numbers = [self.fx, self.fy, self.cx, self.cy, *np.ravel(self.world_to_camera)]
        if not np.all(np.isfinite(numbers)) or min(self.fx, self.fy) <= 0:
            raise ValueError("camera has a number that is not finite, or a focal length that is not positive")
        check_rigid(self.world_to_camera)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Camera) and self.key == other.key)

    def __hash__(self) -> int:
        return hash(self.key)

    @property
    def camera_to_world(self) -> Array:
        """(4, 4) inverse of world_to_camera."""
        return _rigid_inverse(self.world_to_camera)

    @property
    def position(self) -> Array:
        """(3,) centre of projection in world space."""
        return self.camera_to_world[:3, 3]

    @property
    def vertical_fov(self) -> float:
        """Vertical field of view in degrees."""
        return float(np.degrees(np.arctan(self.cy / self.fy) + np.arctan((self.height - self.cy) / self.fy)))

    def at(self, camera_to_world: Array) -> Camera:
        """The same camera at another pose (4, 4); ValueError if that is not rigid."""
        return camera_from_pose(camera_to_world, self.width, self.height, self.fx, self.fy, self.cx, self.cy)

    def moved_right(self, distance: float) -> Camera:
        """The camera moved to its right, by a distance in the units of its coordinates."""
        pose = self.world_to_camera.copy()
        pose[0, 3] -= distance
        return replace(self, world_to_camera=pose)

    def resized(self, width: int, height: int) -> Camera:
        """The same view at another frame size: the vertical field of view stays, a wider frame sees more."""
        scale = height / self.height
        fx, fy, cy = self.fx * scale, self.fy * scale, self.cy * scale
        cx = width / 2 + (self.cx - self.width / 2) * scale
        return replace(self, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)

    def seeing(self, fov: float) -> Camera:
        """The camera with a horizontal field of view in degrees, square pixels and centred."""
        focal = self.width / (2 * math.tan(math.radians(fov) / 2))
        return replace(self, fx=focal, fy=focal, cx=self.width / 2, cy=self.height / 2)

    def cropped(self, left: float, top: float, width: int, height: int) -> Camera:
        """The camera whose frame is a rectangle of this one, `left` and `top` in pixels."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixel positions (N, 2) and depths along the view axis (N,) of world points (N, 3)."""
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        depth = local[:, 2]
        x = self.fx * local[:, 0] / depth + self.cx
        y = self.fy * local[:, 1] / depth + self.cy
        return np.stack([x, y], axis=1), depth

    def shows(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Pixel positions (N, 2) of world points (N, 3), and (N,) which lie in front and within the frame."""
        with np.errstate(divide="ignore", invalid="ignore"):
            position, depth = self.project(points)
        within = (position >= 0) & (position < (self.width, self.height))
        return position, (depth > 0) & within.all(axis=1)

    @property
    def key(self) -> bytes:
        """Bytes of all its numbers: equal for equal cameras only."""
        numbers = (self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        return np.array(numbers, dtype=np.float64).tobytes() + self.world_to_camera.tobytes()

    @staticmethod
    def of_key(key: bytes) -> Camera:
        """The camera with a key; ValueError or OverflowError if there is none."""
        numbers = np.frombuffer(key, dtype=np.float64)
        pose = numbers[6:].reshape(4, 4).copy()
        return Camera(pose, int(numbers[0]), int(numbers[1]), *numbers[2:6].tolist())

    def rays(self, pixels: Array) -> Array:
        """Unit directions (N, 3) in world space through pixel positions (N, 2)."""
        x, y = (pixels[:, 0] - self.cx) / self.fx, (pixels[:, 1] - self.cy) / self.fy
        world = np.stack([x, y, np.ones(len(pixels))], axis=1) @ self.world_to_camera[:3, :3]
        return world / np.linalg.norm(world, axis=1, keepdims=True)

    def pixel_centres(self) -> Array:
        """(H * W, 2) positions of all pixel centres, row by row from the top."""
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([x.ravel(), y.ravel()], axis=1)


def check_rigid(transform: Array) -> None:
    """Raises ValueError, which says why, unless a (4, 4) or (3, 4) transform rotates and translates only."""
    shape = np.shape(transform)
    if shape not in ((4, 4), (3, 4)):
        raise ValueError(f"pose has shape {shape}; must be (4, 4)")
    # Python's own numbers: several times as fast as NumPy's for so few, and cameras are made in every frame.
    rows = np.asarray(transform, dtype=np.float64).tolist()
    if not all(math.isfinite(value) for row in rows for value in row):
        raise ValueError("pose has a number that is not finite")
    x, y, z = (tuple(row[column] for row in rows[:3]) for column in range(3))
    lengths = [math.sqrt(_dot(axis, axis)) for axis in (x, y, z)]
    # In the order of how large an error is: a scaled matrix is not orthogonal either.
    if max(abs(length - 1) for length in lengths) > RIGID_TOLERANCE:
        found = ", ".join(f"{length:.6g}" for length in lengths)
        raise ValueError(f"pose is not rigid: its axes have the lengths {found}; must be 1, without scale")
    off = max(abs(_dot(x, y)), abs(_dot(y, z)), abs(_dot(z, x)))
    if off > 2 * RIGID_TOLERANCE:
        raise ValueError(f"pose is not rigid: its axes have scalar products up to {off:.2g}; must be 0")
    if _dot(x, (y[1] * z[2] - y[2] * z[1], y[2] * z[0] - y[0] * z[2], y[0] * z[1] - y[1] * z[0])) < 0:
        raise ValueError("pose is not rigid: it mirrors (determinant -1); must be a rotation")
    for last in rows[3:]:
        if max(abs(a - b) for a, b in zip(last, (0, 0, 0, 1), strict=True)) > RIGID_TOLERANCE:
            raise ValueError(f"pose has the last row {last}; must be 0 0 0 1")


def _dot(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def camera_from_pose(
    camera_to_world: Array, width: int, height: int, fx: float, fy: float, cx: float, cy: float
) -> Camera:
    """A camera from its pose, (4, 4) camera-to-world in OpenCV axes; ValueError as for `Camera`."""
    # Before it is inverted, which would turn a reflection or a scale into another matrix.
    check_rigid(camera_to_world)
    return Camera(_rigid_inverse(camera_to_world), width, height, float(fx), float(fy), float(cx), float(cy))


def unit(vectors: Array, instead: float | Sequence[float] = 0.0) -> Array:
    """Vectors (N, C) at unit length, and `instead` of those that have none."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(lengths > 0, vectors / np.where(lengths > 0, lengths, 1), instead)


def look_at(position: Array, target: Array, up: Array) -> Array:
    """(4, 4) camera-to-world in OpenCV axes that looks from position to target with up upwards, (3,) each.

    ValueError if position and target are the same, or up points along the direction between them.
    """
    forward, aside = target - position, np.cross(target - position, up)
    distance, sine = np.linalg.norm(forward), np.linalg.norm(aside)
    if not (distance > 0 and sine > _LEAST_SINE * distance * np.linalg.norm(up)):
        raise ValueError(f"no direction from {position} to {target} with {up} upwards")
    forward, right = forward / distance, aside / sine
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = position
    return pose


def _rigid_inverse(transform: Array) -> Array:
    """(4, 4) inverse of a rotation and a translation, of which the last row is not read."""
    rotation, translation = transform[:3, :3], transform[:3, 3]
    inverse = np.eye(4)
    inverse[:3, :3] = rotation.T
    inverse[:3, 3] = -rotation.T @ translation
    return inverse


@dataclass(frozen=True)
class View:
    """What a frame shows: from where, and at which time from 0 to 1; 0 in a scene that stands still."""

    camera: Camera
    time: float = 0.0

    def resized(self, width: int, height: int) -> View:
        """The same view at another size."""
        return replace(self, camera=self.camera.resized(width, height))

    @property
    def key(self) -> bytes:
        """Equal for equal views."""
        return self.camera.key + (b"" if self.time == 0 else repr(self.time).encode())


def between_steps(time: float, count: int) -> tuple[int, float]:
    """Index of the value before a time from 0 to 1, and the share of the way from it to the next one.

    There are `count` values, two or more, the first at time 0 and the last at 1.
    """
    at = time * (count - 1)
    first = min(int(at), count - 2)
    return first, at - first


def turned(rotation: Array, yaw: float, pitch: float) -> Array:
    """(3, 3) camera-to-world rotation in OpenCV axes, turned about the camera's own axes by degrees.

    Yaw to the right, about the y axis, keeps the horizon level; pitch upwards, about the x axis, follows.
    """
    yaw, pitch = np.radians([yaw, pitch])
    about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    return rotation @ about_y @ about_x


def sphere_directions(count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere: a Fibonacci lattice."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    turn = index * np.pi * (1 + 5**0.5)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def eyes(camera: Camera, distance: float) -> tuple[Camera, Camera]:
    """The left and the right eye, `distance` apart, on either side of a camera; both look the same way."""
    return camera.moved_right(-distance / 2), camera.moved_right(distance / 2)
