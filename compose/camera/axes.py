"""Conversion of camera poses between the axis conventions of Mitsuba, OpenGL and OpenCV."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Array

# Each converts camera axes to OpenCV's and, being its own inverse, back again.
_MITSUBA_AXES = np.diag([-1.0, -1.0, 1.0, 1.0])  # x left, y up, z forward
_OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, z backward


def opencv_from_mitsuba(to_world: Array) -> Array:
    """(4, 4) camera-to-world in OpenCV axes from Mitsuba's `to_world`; scale is removed from it."""
    pose = to_world @ _MITSUBA_AXES
    pose = pose.copy()
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
