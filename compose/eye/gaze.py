"""Where the viewer looks, and the eccentricity of everything in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Array, Camera

# How far from the frame a gaze may be, in fractions of its sides: on any display that is beside the viewer,
# and float32 still holds tenths of pixels there.
FURTHEST = 1000


@dataclass(frozen=True)
class Gaze:
    """Where the viewer looks, in fractions of the frame's width and height; may lie outside it.

    Raises:
        ValueError: a coordinate is not a number, or further than FURTHEST frames from the frame.
    """

    x: float = 0.5
    y: float = 0.5

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([self.x, self.y])):
            raise ValueError(f"gaze ({self.x}, {self.y}) is not a pair of finite numbers")
        if max(abs(self.x), abs(self.y)) > FURTHEST:
            raise ValueError(f"gaze ({self.x}, {self.y}) is not within {FURTHEST} frames")

    def pixel(self, width: int, height: int) -> tuple[float, float]:
        """Position (x, y) in pixels of a frame of that size."""
        return self.x * width, self.y * height


def require_within_frame(x: float, y: float) -> None:
    """Checks a gaze, in fractions of the frame, around which quality is to be measured.

    Raises:
        UserError: it lies outside the frame, or is NaN.
    """
    if not (0 <= x <= 1 and 0 <= y <= 1):
        raise UserError(f"gaze {x} {y}: lies outside the frame; must be 0..1 each")


def eccentricity(camera: Camera, gaze: Gaze) -> NDArray[np.float32]:
    """(H, W) angle in degrees between each pixel's ray and the gaze's ray."""
    angle = eccentricity_at(camera, gaze, camera.pixel_centres())
    return angle.reshape(camera.height, camera.width).astype(np.float32)


def eccentricity_at(camera: Camera, gaze: Gaze, pixels: Array) -> Array:
    """(N,) angle in degrees between the rays through pixel positions (N, 2) and the gaze's ray."""
    gaze_ray = camera.rays(np.array([gaze.pixel(camera.width, camera.height)]))[0]
    rays = camera.rays(pixels)
    # arctan2 keeps its precision near zero, where arccos of a dot product loses half its digits.
    sine = np.linalg.norm(np.cross(rays, gaze_ray), axis=1)
    return np.degrees(np.arctan2(sine, rays @ gaze_ray))
