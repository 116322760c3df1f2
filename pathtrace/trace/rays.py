"""Rays of a camera whose parameters are opaque to the kernels."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from compose.base.arrays import uploaded
from compose.camera.camera import Camera


def opaque_camera(camera: Camera) -> tuple[Any, ...]:
    """A camera as one evaluated Dr.Jit array of vectors: origin, ax, ay and az.

    The ray through film coordinates (x, y) has the direction x ax + y ay + az. A new camera changes the
    vectors' values only, so that frozen functions are not recorded again.
    """
    pose = camera.camera_to_world
    ax = pose[:3, 0] / camera.fx
    ay = pose[:3, 1] / camera.fy
    az = pose[:3, 2] - camera.cx * ax - camera.cy * ay
    return (uploaded(mi.Float, np.array([pose[:3, 3], ax, ay, az], dtype=np.float32)),)


def ray_through(camera: tuple[Any, ...], x: Any, y: Any) -> Any:
    """Rays of an `opaque_camera` through film coordinates x and y, (N,) Dr.Jit floats."""
    values = [dr.gather(mi.Float, camera[0], i) for i in range(12)]
    origin = mi.Point3f(*values[:3])
    ax, ay, az = (mi.Vector3f(*values[i : i + 3]) for i in (3, 6, 9))
    return mi.RayDifferential3f(origin, dr.normalize(dr.fma(ax, x, dr.fma(ay, y, az))))
