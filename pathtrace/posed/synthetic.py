"""The layout of NeRF's synthetic scenes, and of D-NeRF: transforms_train.json and transforms_test.json.

Frames are `file_path` (without .png), `transform_matrix` (camera to world in OpenGL axes) and, of scenes that
move, `time`; `camera_angle_x` is the horizontal field of view in radians (Mildenhall et al. 2020; Pumarola et
al. 2021).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from compose.base.inside import file_inside
from compose.camera.axes import opencv_from_opengl
from compose.camera.camera import Camera, camera_from_pose
from pathtrace.posed.documents import described_by, document, time_of
from pathtrace.posed.folder import PosedImage
from pathtrace.posed.pixels import read_size

NAME = "NeRF-synthetic or D-NeRF"
TRAINING = "transforms_train.json"
# Held out are test images; of a folder without any, those for validation.
_HELD_OUT = "transforms_test.json", "transforms_val.json"


def read_synthetic(folder: Path) -> list[PosedImage]:
    """The images of a folder, training ones first.

    Raises:
        UserError: a file is missing or damaged, or a frame has values that make no view.
    """
    images = _frames(folder, TRAINING, False)
    for name in _HELD_OUT:
        if (folder / name).is_file():
            return images + _frames(folder, name, True)
    return images


def _frames(folder: Path, name: str, held_out: bool) -> list[PosedImage]:
    path = folder / name
    content = document(path)
    with described_by(path):
        angle = float(content["camera_angle_x"])
        if not 0 < angle < math.pi:
            raise ValueError(f"camera_angle_x {angle:g}: must be in radians, above 0 and below pi")
        frames = list(content["frames"])
    found = []
    for number, frame in enumerate(frames):
        with described_by(path, f"frame {number}"):
            found.append(_image(folder, frame, angle, held_out))
    return found


def _image(folder: Path, frame: dict[str, Any], angle: float, held_out: bool) -> PosedImage:
    file = file_inside(folder, frame["file_path"])
    if file.suffix.lower() != ".png":
        file = file.with_name(file.name + ".png")
    camera = _camera(frame["transform_matrix"], angle, *read_size(file))
    return PosedImage(camera, None, file, None, time_of(frame.get("time", 0.0)), held_out)


def _camera(matrix: Any, angle: float, width: int, height: int) -> Camera:
    pose = np.asarray(matrix, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError("transform_matrix must be 4 x 4 finite numbers")
    focal = width / 2 / math.tan(angle / 2)
    return camera_from_pose(opencv_from_opengl(pose), width, height, focal, focal, width / 2, height / 2)
