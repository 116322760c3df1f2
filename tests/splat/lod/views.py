"""A forest, a camera and lattices for the tests of this folder."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Camera, camera_from_pose
from splat.model.building import build_forest
from splat.model.forest import Forest, forest_of
from splat.model.layer import static_layer
from tests.splat.samples import gaussians

WIDTH, HEIGHT = 150, 100
CORNERS = (-(-HEIGHT // 16) + 1, -(-WIDTH // 16) + 1)
CELLS = (CORNERS[0] - 1, CORNERS[1] - 1)


def frame_camera(width: int = WIDTH, height: int = HEIGHT) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = [0.1, -0.2, -4]
    return camera_from_pose(pose, width, height, 120.0, 120.0, width / 2, height / 2)


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
