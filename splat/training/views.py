"""Frames that Gaussians are trained on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera


@dataclass(frozen=True)
class TrainingView:
    """One frame to train on.

    Attributes:
        camera: the view.
        radiance: (H, W, 3) float32, linear.
        distance: (H, W) float32 along the ray to the visible surface; for a mirror, to where the reflected
            surface appears behind it; inf where nothing is hit.
        normal: (H, W, 3) float32 in world space, zero where it is unknown.
    """

    camera: Camera
    radiance: NDArray[np.float32]
    distance: NDArray[np.float32]
    normal: NDArray[np.float32]


def pixel_footprint(views: list[TrainingView]) -> float:
    """Size of a pixel in world space at the median distance of what the views see."""
    distances = [v.distance[np.isfinite(v.distance)] for v in views]
    seen = np.concatenate([d for d in distances if len(d)] or [np.ones(1, np.float32)])
    return float(np.median(seen)) / views[0].camera.fy


def reduced(view: TrainingView, factor: int) -> TrainingView:
    """A view at 1 / factor of its resolution, without the rows and columns after the last whole pixel."""
    if factor == 1:
        return view
    camera = view.camera
    height, width = camera.height // factor, camera.width // factor
    radiance = view.radiance[: height * factor, : width * factor]
    radiance = radiance.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))
    # A mean of distances would lie between a table's edge and the floor; the middle one lies on one of them.
    middle = np.s_[factor // 2 : height * factor : factor, factor // 2 : width * factor : factor]
    return TrainingView(
        _reduced_camera(camera, factor),
        np.ascontiguousarray(radiance),
        np.ascontiguousarray(view.distance[middle]),
        np.ascontiguousarray(view.normal[middle]),
    )


def _reduced_camera(camera: Camera, factor: int) -> Camera:
    """The same view with pixels of factor x factor."""
    return replace(
        camera,
        width=camera.width // factor,
        height=camera.height // factor,
        fx=camera.fx / factor,
        fy=camera.fy / factor,
        cx=camera.cx / factor,
        cy=camera.cy / factor,
    )
