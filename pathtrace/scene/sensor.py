"""The camera of a Mitsuba sensor."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from compose.base.errors import UserError
from compose.camera.axes import opencv_from_mitsuba
from compose.camera.camera import Camera, camera_from_pose


def camera_of_sensor(sensor: Any, source: str) -> Camera:
    """The camera of a perspective sensor, at the size of its film; `source` stands in error messages.

    Raises:
        UserError: the sensor is not a perspective one, or its to_world mirrors or shears.
    """
    parameters = mi.traverse(sensor)
    if "x_fov" not in parameters:
        raise UserError(f"{source}: the camera is not a perspective one; use <sensor type='perspective'>")
    width, height = (int(v) for v in sensor.film().size())
    focal = 0.5 * width / np.tan(np.radians(float(parameters["x_fov"][0])) / 2)
    offset = [float(parameters[f"principal_point_offset_{axis}"][0]) for axis in "xy"]
    to_world = np.array(sensor.world_transform().matrix, dtype=np.float64).reshape(4, 4)
    centre = width * (0.5 - offset[0]), height * (0.5 - offset[1])
    try:
        return camera_from_pose(opencv_from_mitsuba(to_world), width, height, focal, focal, *centre)
    except ValueError as error:
        raise UserError(f"{source}: the camera's to_world: {error}") from error
