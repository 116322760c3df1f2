"""The views that a forest was trained on, which its file contains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from compose.base.errors import UserError
from compose.camera.camera import Camera
from splat.model.forest import Forest

_NAME = "views.cameras"
# Width, height, focal lengths and principal point, then the world-to-camera transform.
_NUMBERS = 6 + 16


def attach_views(forest: Forest, cameras: Sequence[Camera]) -> Forest:
    """The forest with the views that it was trained on attached, in the coordinates of its frame set."""
    rows = [np.frombuffer(camera.key, dtype=np.float64) for camera in cameras]
    table = torch.from_numpy(np.array(rows).reshape(-1, _NUMBERS))
    return replace(forest, attached={**forest.attached, _NAME: table})


def views_of(forest: Forest) -> list[Camera]:
    """The views that a forest was trained on; none if it does not say.

    Raises:
        UserError: the views are damaged.
    """
    table = forest.attached.get(_NAME)
    if table is None:
        return []
    try:
        if table.dtype != torch.float64 or table.shape[1:] != (_NUMBERS,):
            raise ValueError(f"{table.dtype} of shape {tuple(table.shape)}")
        return [_camera(row) for row in table.numpy()]
    except (ValueError, OverflowError) as error:
        raise UserError(
            f"the forest's training views are damaged ({error}); train the forest again"
        ) from error


def _camera(row: np.ndarray) -> Camera:
    width, height, fx, fy, cx, cy = row[:6].tolist()
    return Camera(row[6:].reshape(4, 4).copy(), int(width), int(height), fx, fy, cx, cy)
