"""Frames to train on, made without a renderer."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Camera, camera_from_pose
from splat.training.views import TrainingView

SIZE = 32


def pose(x: float) -> np.ndarray:
    """Looks along +z from (x, 0, -3)."""
    matrix = np.eye(4)
    matrix[:3, 3] = [x, 0, -3]
    return matrix


def wall(x: float) -> TrainingView:
    """A striped wall at z = 0 with a lamp of radiance 50 on it."""
    camera = camera_from_pose(pose(x), SIZE, SIZE, 40, 40, SIZE / 2, SIZE / 2)
    rays = camera.rays(camera.pixel_centres())
    distance = 3 / rays[:, 2]
    points = camera.position + rays * distance[:, None]
    stripe = np.where(np.floor(points[:, 0] * 3) % 2 == 0, 0.1, 0.6)
    colour = np.stack([stripe, stripe * 0.5, 0.3 + 0 * stripe], axis=1)
    colour[np.hypot(points[:, 0] - 0.4, points[:, 1]) < 0.25] = 50.0
    return made(camera, colour, distance, np.array([0, 0, -1], np.float32))


def closed_sphere(x: float) -> TrainingView:
    """Inside a sphere of radius 3 around the origin, whose radiance is 1 everywhere."""
    matrix = pose(x)
    matrix[2, 3] = -1
    camera = camera_from_pose(matrix, SIZE, SIZE, 28, 28, SIZE / 2, SIZE / 2)
    rays = camera.rays(camera.pixel_centres())
    along = rays @ camera.position
    distance = -along + np.sqrt(along**2 - camera.position @ camera.position + 9)
    points = camera.position + rays * distance[:, None]
    return made(camera, np.ones((SIZE**2, 3)), distance, (-points / 3).astype(np.float32))


def made(camera: Camera, colour: np.ndarray, distance: np.ndarray, normal: np.ndarray) -> TrainingView:
    """A view from rows of pixels."""
    shape = (SIZE, SIZE)
    return TrainingView(
        camera,
        colour.reshape(*shape, 3).astype(np.float32),
        distance.reshape(shape).astype(np.float32),
        np.broadcast_to(normal, (SIZE**2, 3)).reshape(*shape, 3).copy(),
    )


WALLS = [wall(x) for x in (-0.4, 0.0, 0.4)]
