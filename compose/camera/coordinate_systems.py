"""Coordinate systems of cameras: a scene's own, the axes of Mitsuba, OpenGL and OpenCV, and transforms.json.

Kernels compute in float32, with near planes and distances of their own. In a scene's own coordinates, whose
origin lies amid what is seen and whose unit is a share of how far away that is, they are as exact in a room
of a tenth of a millimetre, or a million rooms away from the world's origin, as in a room of four metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import MOST_PIXELS
from compose.camera.camera import Array, Camera, camera_from_pose

# Seen from its views, a scene lies about this many units away, as a room does in metres.
TYPICAL_DISTANCE = 4.0
# Names in transforms.json.
_INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy")
# Each converts camera axes to OpenCV's and, being its own inverse, back again.
_MITSUBA_AXES = np.diag([-1.0, -1.0, 1.0, 1.0])  # x left, y up, z forward
_OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, z backward


@dataclass(frozen=True)
class Place:
    """A scene's own coordinates: a point p of them lies at origin + unit * p in the world.

    ValueError if a number is not finite, or the unit not positive.
    """

    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: float = 1.0

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([*self.origin, self.unit])) or self.unit <= 0:
            raise ValueError(f"origin {self.origin}, unit {self.unit}: must be finite, the unit positive")

    def camera(self, world: Camera) -> Camera:
        """A camera of the world in these coordinates; computed in float64."""
        pose = np.array(world.world_to_camera, dtype=np.float64)
        pose[:3, 3] = (pose[:3, 3] + pose[:3, :3] @ np.array(self.origin)) / self.unit
        return replace(world, world_to_camera=pose)

    def in_world(self, points: NDArray[np.floating]) -> Array:
        """World positions (N, 3) of points (N, 3) of these coordinates."""
        return np.asarray(points, dtype=np.float64) * self.unit + np.array(self.origin)

    def from_world(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Points (..., 3) of these coordinates from world positions."""
        return (np.asarray(points, dtype=np.float64) - np.array(self.origin)) / self.unit


# Coordinates that are those of the world.
WORLD = Place()


def place_around(points: NDArray[np.floating], distance: float) -> Place:
    """The place of a scene of which points (N, 3) are seen, at that typical distance."""
    x, y, z = np.median(np.asarray(points, dtype=np.float64), axis=0).tolist()
    return Place((x, y, z), distance / TYPICAL_DISTANCE)


def opencv_from_mitsuba(to_world: Array) -> Array:
    """(4, 4) camera-to-world in OpenCV axes from Mitsuba's `to_world`; scale is removed from it."""
    pose = to_world @ _MITSUBA_AXES
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0, keepdims=True)
    return pose


def mitsuba_from_opencv(camera_to_world: Array) -> Array:
    """(4, 4) Mitsuba's `to_world` from a camera-to-world matrix in OpenCV axes."""
    return camera_to_world @ _MITSUBA_AXES


def opencv_from_opengl(transform_matrix: Array) -> Array:
    """(4, 4) camera-to-world in OpenCV axes from the `transform_matrix` of transforms.json (OpenGL axes)."""
    return transform_matrix @ _OPENGL_AXES


def opengl_from_opencv(camera_to_world: Array) -> Array:
    """(4, 4) `transform_matrix` of transforms.json (OpenGL axes) from camera-to-world in OpenCV axes."""
    return camera_to_world @ _OPENGL_AXES


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """A camera's intrinsics and pose under the names of transforms.json."""
    numbers = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    pose = opengl_from_opencv(camera.camera_to_world).tolist()
    return dict(zip(_INTRINSICS, numbers, strict=True)) | {"transform_matrix": pose}


def camera_from_json(entry: dict[str, Any]) -> Camera:
    """The camera that an entry of transforms.json describes; the inverse of `camera_to_json`.

    KeyError if a name is missing; TypeError or ValueError if a value is of the wrong type or shape: a size
    must be a whole number of pixels, the matrix 4 x 4 (its last row may be missing) and rigid.
    """
    try:
        matrix = np.asarray(entry["transform_matrix"], dtype=np.float64)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"transform_matrix is not a matrix of numbers ({error})") from error
    if matrix.shape not in ((4, 4), (3, 4)):
        shape = " x ".join(map(str, matrix.shape)) or "a single number"
        raise ValueError(f"transform_matrix is {shape}; must be 4 x 4, one list per row")
    if not np.isfinite(matrix).all():
        raise ValueError("transform_matrix has a number that is not finite")
    width, height = (_whole_pixels(entry, name) for name in ("w", "h"))
    if width * height > MOST_PIXELS:
        raise ValueError(f"frame size {width} x {height}; at most {MOST_PIXELS:,} pixels")
    pose = opencv_from_opengl(matrix)
    return camera_from_pose(pose, width, height, entry["fl_x"], entry["fl_y"], entry["cx"], entry["cy"])


def _whole_pixels(entry: dict[str, Any], name: str) -> int:
    value = entry[name]
    # Other programs write 640.0; true is a number in Python only.
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{name} is {value!r}; must be a whole number of pixels")
    return value
