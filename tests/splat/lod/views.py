"""A forest, a camera and lattices for the tests of this folder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compose.camera.camera import Camera, camera_from_pose
from splat.lod.forest_renderer import ForestRenderer
from splat.lod.layer_images import SplatImage
from splat.model.forest import Forest, forest_of
from splat.model.trees import build_forest, static_layer
from tests.splat.raster import reference
from tests.splat.samples import gaussians

WIDTH, HEIGHT = 150, 100
CORNERS = (-(-HEIGHT // 16) + 1, -(-WIDTH // 16) + 1)
CELLS = (CORNERS[0] - 1, CORNERS[1] - 1)


def frame_camera(width: int = WIDTH, height: int = HEIGHT) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = [0.1, -0.2, -4]
    return camera_from_pose(pose, width, height, 120.0, 120.0, width / 2, height / 2)


def overlapping_forest() -> Forest:
    """300 Gaussians, many of which overlap, in one layer."""
    leaves = gaussians("overlap", 300, 1)
    leaves.log_scales -= 1.5
    return forest_of([static_layer(leaves)], 120.0, "", "")


def flat(level: float) -> np.ndarray:
    """A lattice on which every level is the same."""
    return np.full(CORNERS, level, dtype=np.float32)


def small_forest(n: int = 80) -> Forest:
    """Three layers, trained with the focal length of `frame_camera`."""
    return forest_of(build_forest(static_layer(gaussians("overlap", n, 1)), 0.05, 3), 120.0, "", "")


def ramp(low: float, high: float) -> np.ndarray:
    """A lattice that rises from left to right."""
    return np.tile(np.linspace(low, high, CORNERS[1], dtype=np.float32), (CORNERS[0], 1))


def no_cutoff() -> np.ndarray:
    return np.full(CORNERS, 0.5, dtype=np.float32)


def everything() -> np.ndarray:
    return np.ones(CELLS, dtype=bool)


def sampled(forest: Forest, camera: Camera, layer: int, rate: int, variance) -> np.ndarray:
    """A layer at one sample per 2^rate x 2^rate pixels: the twin on a camera with larger pixels.

    The variance in px^2 is one number, or one per Gaussian.
    """
    size = 1 << rate
    # Not rounded, since the projection's limits follow from the frame's width.
    small = replace(
        camera,
        width=camera.width / size,
        height=camera.height / size,
        fx=camera.fx / size,
        fy=camera.fy / size,
        cx=camera.cx / size,
        cy=camera.cy / size,
    )
    g = reference.double(forest.layers[layer - 1].gaussians)
    splats = reference.project(g, small, variance / size**2)
    return reference.blend(splats, -(-camera.width // size), -(-camera.height // size)).numpy()


def drawn(renderer: ForestRenderer, *given) -> SplatImage:
    """The frame of `render` without the image that lies under it."""
    return renderer.render(*given)[0]
