"""Reads a camera's path.

The file is JSON with the pose of each frame, in the coordinates of the scene's file:

    {"radius": 0.3, "frames": [
        {"position": [1, 1.6, 0], "look_at": [3, 1.2, 0], "up": [0, 1, 0]},
        {"transform_matrix": [[...], [...], [...], [...]]}]}

A pose is a matrix as in transforms.json (camera-to-world, OpenGL axes), whose files are paths therefore, or a
position, what it looks at, and what is up, which may be left out. `radius` may be left out as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.errors import UserError, one_line
from compose.base.json_file import read_json
from compose.camera.camera import Array, look_at
from compose.camera.serialization import camera_from_json

_MOST_BYTES = 1 << 24
# The path is part of what is trained, and goes into its files.
MOST_POSES = 1000
# Cameras as JSON need some.
_ANY_INTRINSICS = {"w": 1, "h": 1, "fl_x": 1.0, "fl_y": 1.0, "cx": 0.5, "cy": 0.5}


@dataclass(frozen=True)
class CameraPath:
    """A camera's path, in the coordinates of the scene's file.

    Attributes:
        poses: at least one, (4, 4) camera-to-world each, OpenCV axes.
        radius: of the space around it; None to leave the choice to the region.
    """

    poses: list[Array]
    radius: float | None


def read_path(file: Path, up: Array) -> CameraPath:
    """The path that a file holds.

    Args:
        file: the file.
        up: (3,) what is up where a pose does not say so.

    Raises:
        UserError: the file cannot be read, or is no path.
    """
    try:
        document = read_json(file, _MOST_BYTES)
    except (OSError, ValueError) as error:
        raise UserError(f"{file}: cannot be read ({one_line(error)})") from error
    return path_from_json(document, up, str(file))


def path_from_json(document: Any, up: Array, name: str) -> CameraPath:
    """The path of such a file's content; `name` is for error messages, the rest as of `read_path`."""
    frames = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(frames, list) or not frames:
        raise UserError(f"{name}: is no camera path; must be JSON with a list of poses under frames")
    if len(frames) > MOST_POSES:
        raise UserError(f"{name}: {len(frames):,} frames; must be at most {MOST_POSES:,}")
    radius = document.get("radius")
    if radius is not None and not _is_positive(radius):
        raise UserError(f"{name}: radius is {one_line(repr(radius))}; must be a positive number")
    poses = []
    for index, frame in enumerate(frames):
        try:
            poses.append(_pose(frame, up))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            what = f"has no {error.args[0]}" if isinstance(error, KeyError) else one_line(error)
            raise UserError(
                f"{name}: frames[{index}] is no pose ({what}); must have transform_matrix, or position and "
                "look_at"
            ) from error
    return CameraPath(poses, radius)


def _is_positive(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < np.inf


def _pose(frame: Any, up: Array) -> Array:
    """(4, 4) camera-to-world of a frame, OpenCV axes."""
    if not isinstance(frame, dict):
        raise ValueError("not an object")
    if "transform_matrix" in frame:
        matrix = frame["transform_matrix"]
        return camera_from_json({**_ANY_INTRINSICS, "transform_matrix": matrix}).camera_to_world
    return look_at(_point(frame, "position"), _point(frame, "look_at"), _point({"up": up, **frame}, "up"))


def _point(frame: dict[str, Any], name: str) -> Array:
    """(3,) numbers of a frame."""
    value = np.asarray(frame[name], dtype=np.float64)
    if value.shape != (3,) or not np.isfinite(value).all():
        raise ValueError(f"{name} is not three numbers")
    return value
