"""Rays of a camera whose parameters are opaque to the kernels."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from compose.camera.camera import Camera


def opaque_camera(camera: Camera) -> tuple[Any, ...]:
    """A camera as evaluated Dr.Jit vectors: origin, ax, ay and az.

    The ray through film coordinates (x, y) has the direction x ax + y ay + az. A new camera changes the
    vectors' values only, so that frozen functions are not recorded again.
    """
    pose = camera.camera_to_world
    ax = pose[:3, 0] / camera.fx
    ay = pose[:3, 1] / camera.fy
    az = pose[:3, 2] - camera.cx * ax - camera.cy * ay
    origin, *axes = (vector.tolist() for vector in (pose[:3, 3], ax, ay, az))
    vectors = mi.Point3f(*origin), *(mi.Vector3f(*axis) for axis in axes)
    dr.make_opaque(vectors)
    return vectors


def ray_through(camera: tuple[Any, ...], x: Any, y: Any) -> Any:
    """Rays of an `opaque_camera` through film coordinates x and y, (N,) Dr.Jit floats."""
    origin, ax, ay, az = camera
    return mi.RayDifferential3f(origin, dr.normalize(dr.fma(ax, x, dr.fma(ay, y, az))))
