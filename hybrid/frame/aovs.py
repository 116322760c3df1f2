"""The layers of an EXR file of a hybrid frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze, eccentricity
from compose.fusion.parents import PARENTS
from hybrid.frame.frame import Frame
from hybrid.frame.renderer import HybridRenderer
from hybrid.pictures.levels import per_pixel
from pathtrace.trace.film import frame_positions


def frame_layers(
    renderer: HybridRenderer, camera: Camera, gaze: Gaze, frame: Frame
) -> dict[str, NDArray[np.float32]]:
    """Everything that a frame consists of.

    Layers: the composite (unnamed, and once more under its name), fovea as it was blended, path-traced as it
    came from Mitsuba and variance of that, denoised, splat (H, W, 3); weight of the fovea, eccentricity in
    degrees on the viewer's display, level (1 to L), rate (log2 of pixels per sample along each axis), depth
    along the view axis (H, W), and, of a fused fovea, the share of each parent (fusion.traced, ...).
    Variance is infinite where a single sample does not tell.
    """
    hits = renderer.tracer.hits(camera, frame_positions(camera))
    cosine = camera.rays(camera.pixel_centres()) @ camera.camera_to_world[:3, 2]
    viewer = renderer.periphery.viewing.display.viewer(camera.width, camera.height)
    depth = (hits.distance * cosine).astype(np.float32).reshape(camera.height, camera.width)
    return {
        "": frame.composite,
        "composite": frame.composite,
        "fovea": frame.of_disc(frame.fovea.radiance),
        "path-traced": frame.of_disc(frame.fovea.samples.radiance),
        "variance": frame.of_disc(frame.fovea.samples.variance()),
        **_of_parents(frame),
        "splat": renderer.splat_frame(camera),
        "weight": frame.region.weight_image(),
        "eccentricity": eccentricity(viewer, gaze),
        "level": per_pixel(frame.detail, frame.detail.drawn_level),
        "rate": per_pixel(frame.detail, frame.detail.drawn_rate),
        "depth": depth,
    }


def _of_parents(frame: Frame) -> dict[str, NDArray[np.float32]]:
    """What only a denoised or a fused fovea has."""
    fovea, layers = frame.fovea, {}
    if fovea.denoised is not None:
        layers["denoised"] = frame.of_disc(fovea.denoised)
    if fovea.weights is not None:
        shares = frame.of_disc(fovea.weights)
        layers |= {f"fusion.{name}": shares[..., i] for i, name in enumerate(PARENTS)}
    return layers
