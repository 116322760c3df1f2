"""The layers of an EXR file of a hybrid frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.view import Camera, Gaze, eccentricity
from hybrid.detail_picture import per_pixel
from hybrid.renderer import Frame, HybridRenderer
from pathtrace.tracer import frame_positions


def frame_layers(
    renderer: HybridRenderer, camera: Camera, gaze: Gaze, frame: Frame
) -> dict[str, NDArray[np.float32]]:
    """Everything that a frame consists of.

    Layers: the composite (unnamed, and once more under its name), path-traced, splat (H, W, 3); weight of
    the path-traced radiance, eccentricity in degrees on the viewer's display, level (1 to L), rate (log2 of
    pixels per sample along each axis), and depth along the view axis (H, W).
    """
    hits = renderer.tracer.hits(camera, frame_positions(camera))
    cosine = camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]
    viewer = renderer.periphery.viewing.display.viewer(camera.width, camera.height)
    depth = (hits.distance * cosine).astype(np.float32).reshape(camera.height, camera.width)
    return {
        "": frame.composite,
        "composite": frame.composite,
        "path-traced": frame.fovea_image(),
        "splat": renderer.splat_frame(camera),
        "weight": frame.plan.weight_image(),
        "eccentricity": eccentricity(viewer, gaze),
        "level": per_pixel(frame.detail, frame.detail.drawn_level),
        "rate": per_pixel(frame.detail, frame.detail.drawn_rate),
        "depth": depth,
    }
