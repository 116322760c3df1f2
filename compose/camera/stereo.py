"""The two eyes of a viewer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compose.camera.camera import Camera

EYES = ("left", "right")


def eyes(camera: Camera, distance: float) -> tuple[Camera, Camera]:
    """The left and the right eye of a viewer between whose eyes a camera is; both look the same way.

    Args:
        camera: midway between the eyes.
        distance: between them, in the camera's coordinates.
    """
    left, right = (_shifted(camera, side * distance / 2) for side in (-1, 1))
    return left, right


def _shifted(camera: Camera, right: float) -> Camera:
    """The camera moved to its right."""
    pose = np.array(camera.world_to_camera)
    pose[0, 3] -= right
    return replace(camera, world_to_camera=pose)
