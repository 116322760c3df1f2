"""Cameras as JSON with the field names of transforms.json."""

from __future__ import annotations

from typing import Any

import numpy as np

from compose.base.limits import MOST_PIXELS
from compose.camera.axes import opencv_from_opengl, opengl_from_opencv
from compose.camera.camera import Array, Camera, camera_from_pose


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """A camera's intrinsics and pose under the names of transforms.json."""
    return {
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "transform_matrix": opengl_from_opencv(camera.camera_to_world).tolist(),
    }


def camera_from_json(entry: dict[str, Any]) -> Camera:
    """The camera that an entry of transforms.json describes; the inverse of `camera_to_json`.

    Raises:
        KeyError: a name is missing.
        TypeError, ValueError: a value is of the wrong type or shape; a size must be a whole number of pixels,
            the matrix 4 x 4 (its last row may be missing) and rigid.
    """
    pose = opencv_from_opengl(_matrix(entry["transform_matrix"]))
    width, height = (_whole_pixels(entry, name) for name in ("w", "h"))
    if width * height > MOST_PIXELS:
        raise ValueError(f"frame size {width} x {height}; at most {MOST_PIXELS:,} pixels")
    return camera_from_pose(pose, width, height, entry["fl_x"], entry["fl_y"], entry["cx"], entry["cy"])


def _matrix(rows: Any) -> Array:
    """(4, 4) or (3, 4) from nested lists."""
    try:
        matrix = np.asarray(rows, dtype=np.float64)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"transform_matrix is not a matrix of numbers ({error})") from error
    if matrix.shape not in ((4, 4), (3, 4)):
        shape = " x ".join(map(str, matrix.shape)) or "a single number"
        raise ValueError(f"transform_matrix is {shape}; must be 4 x 4, one list per row")
    if not np.isfinite(matrix).all():
        raise ValueError("transform_matrix has a number that is not finite")
    return matrix


def _whole_pixels(entry: dict[str, Any], name: str) -> int:
    value = entry[name]
    # Other programs write 640.0; only to Python is true a number.
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{name} is {value!r}; must be a whole number of pixels")
    return value
