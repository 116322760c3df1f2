"""The last step before a frame is shown: it is warped to where the viewer is by then."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import uploaded
from compose.camera.camera import Camera
from compose.fovea.warping import CELL, grid, warped
from compose.image.device_image import DeviceImage
from hybrid.base.compute_device import PassClock, device_arrays
from hybrid.window.frame_source import FrameSource
from hybrid.window.messages import ShownFrame
from pathtrace.trace.film import FilmPositions, pixel_positions

# Distance along each axis up to which two viewpoints are the same: all depths look alike then.
_SAME_VIEWPOINT = 1e-6
# Nothing is nearer, or an inverse depth would be infinite.
_NEAREST = 1e-6


def late_warped(shown: ShownFrame, newest: Camera, source: FrameSource) -> ShownFrame:
    """The last frame of a source as the newest camera sees it, at the frame's size.

    It is returned as it is if that camera is its own. The disc stays where it was traced. The time taken is
    that of a pass, "warp".
    """
    if newest == shown.request.settings.camera:
        return shown
    clock, arrays, camera = PassClock(), device_arrays(), shown.frame.camera
    newest = newest.resized(camera.width, camera.height)
    plain, size = arrays.plain, (camera.width, camera.height)
    values = plain.Float(uploaded(dr.uint8_array_t(plain.Float), shown.image))
    dr.eval(values)
    image = DeviceImage(arrays, values, *size, camera.width)
    flat = warped(image, _nearness(camera, newest, source), camera, newest).values
    pixels = np.asarray(dr.uint8_array_t(plain.Float)(flat + 0.5)).reshape(shown.image.shape)
    clock.lap("warp")
    passes, took = dict(shown.milliseconds), clock.milliseconds()
    took["total"] += passes.pop("total", 0.0)
    return replace(shown, image=pixels, milliseconds=passes | took)


def _nearness(camera: Camera, newest: Camera, source: FrameSource) -> Any:
    """Float, the inverse depth of what the camera sees in each cell; 0 if the newest one has only turned."""
    arrays, (rows, columns) = device_arrays(), grid(camera)
    plain = arrays.plain
    if np.allclose(camera.position, newest.position, rtol=0, atol=_SAME_VIEWPOINT):
        return dr.zeros(plain.Float, rows * columns)
    corner = pixel_positions(dr.arange(plain.UInt, rows * columns), columns)
    centres = FilmPositions((corner.x + 0.5) * CELL, (corner.y + 0.5) * CELL, 0.0, 0.0)
    dr.eval(centres.x, centres.y)
    position = source.renderer.tracer.auxiliary(camera, centres, 1, 0).position
    *axis, origin = arrays.scalars(plain.Float, camera.world_to_camera[2])
    depth = sum(plain.Float(at) * along for at, along in zip(position, axis, strict=True)) + origin
    return 1 / dr.maximum(depth, _NEAREST)
