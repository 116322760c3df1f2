"""Turning a camera, as a viewer who looks around does."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Array


def turned(rotation: Array, yaw: float, pitch: float) -> Array:
    """(3, 3) camera-to-world rotation, turned about the camera's own axes.

    Yaw, about the y axis, keeps the horizon level; pitch, about the x axis, follows.

    Args:
        rotation: (3, 3) camera-to-world, OpenCV axes.
        yaw: degrees to the right.
        pitch: degrees upwards.
    """
    yaw, pitch = np.radians([yaw, pitch])
    about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    return rotation @ about_y @ about_x
