"""Cameras as JSON, with the field names of transforms.json."""

from __future__ import annotations

from typing import Any

import numpy as np

from compose.camera.axes import opencv_from_opengl, opengl_from_opencv
from compose.camera.camera import Camera, camera_from_pose


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """Intrinsics and pose with the names of transforms.json."""
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
    """Inverse of camera_to_json.

    Raises:
        KeyError: a name is missing.
        TypeError, ValueError: what it holds is not of its kind; a size must be a whole number of pixels.
    """
    pose = opencv_from_opengl(np.asarray(entry["transform_matrix"], dtype=np.float64))
    width, height = (_whole_pixels(entry, name) for name in ("w", "h"))
    return camera_from_pose(pose, width, height, entry["fl_x"], entry["fl_y"], entry["cx"], entry["cy"])


def _whole_pixels(entry: dict[str, Any], name: str) -> int:
    value = entry[name]
    # Other programs write 640.0; true is a number only to Python.
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{name} is {value!r}; must be a whole number of pixels")
    return value
