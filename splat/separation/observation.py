"""What frames show, as far as it tells what moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera

# Added to radiance before its logarithm is taken.
_DARK = 0.01


@dataclass(frozen=True)
class Observation:
    """One frame of something that may move.

    Attributes:
        camera: the view.
        radiance: (H, W, 3) float32, linear.
        distance: (H, W) float32 along the ray to what is seen, as it is known or as a forest renders it; inf
            where nothing is.
        time: that the frame shows, from 0 to 1.
        albedo: (H, W, 3) float32; None if it is not known.
    """

    camera: Camera
    radiance: NDArray[np.float32]
    distance: NDArray[np.float32]
    time: float
    albedo: NDArray[np.float32] | None = None

    @property
    def appearance(self) -> NDArray[np.float32]:
        """(H, W, 3) what surfaces look like whatever the light: albedo, else the logarithm of radiance.

        A light that changes by a factor adds the same to that logarithm everywhere.
        """
        if self.albedo is not None:
            return self.albedo
        return np.log(np.maximum(self.radiance, 0) + _DARK).astype(np.float32)

    @property
    def inverse_depth(self) -> NDArray[np.float32]:
        """(H, W) one over the depth along the view axis, linear in the frame on a plane; 0 at infinity."""
        rays = self.camera.rays(self.camera.pixel_centres())
        cosine = (rays @ self.camera.world_to_camera[2, :3]).reshape(self.distance.shape)
        known = np.isfinite(self.distance) & (self.distance > 0)
        depth = np.where(known, self.distance, 1) * cosine
        return np.where(known, 1 / depth, 0).astype(np.float32)

    def points(self) -> NDArray[np.float64]:
        """(H, W, 3) world positions of what is seen; NaN where nothing is."""
        rays = self.camera.rays(self.camera.pixel_centres()).reshape(*self.distance.shape, 3)
        known = np.isfinite(self.distance) & (self.distance > 0)
        distance = np.where(known, self.distance.astype(np.float64), np.nan)
        return self.camera.position + rays * distance[..., None]
