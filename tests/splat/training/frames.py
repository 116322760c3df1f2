"""Frames to train on, made without a renderer."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import Camera, camera_from_pose
from splat.training.training_view import TrainingView

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


def in_the_open(
    x: float, pitch: float = 0.0, ground: bool = False, ball: bool = False, sun: bool = False
) -> TrainingView:
    """Under a blue sky that is paler towards the horizon, from (x, 0, -3); world axes are those of pose(x).

    Args:
        x: where from.
        pitch: degrees by which the camera looks up.
        ground: a striped plane 1 below the camera that reaches to the horizon.
        ball: of radius 0.25 in the middle.
        sun: 4 degrees wide and of radiance 1e4, 20 degrees above the horizon.
    """
    matrix, angle = pose(x), np.radians(pitch)
    matrix[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    camera = camera_from_pose(matrix, SIZE, SIZE, 30, 30, SIZE / 2, SIZE / 2)
    rays = camera.rays(camera.pixel_centres())
    up = np.clip(-rays[:, 1:2], 0, 1) ** 0.5
    colour = (1 - up) * [0.6, 0.7, 0.8] + up * [0.1, 0.25, 0.6]
    if sun:
        toward = rays @ [0, -np.sin(np.radians(20)), np.cos(np.radians(20))]
        colour[toward > np.cos(np.radians(2))] = 1e4
    distance, normal = np.full(len(rays), np.inf), np.zeros((len(rays), 3), np.float32)
    if ground:
        below = rays[:, 1] > 1e-9
        distance[below] = 1 / rays[below, 1]
        where = camera.position + rays[below] * distance[below, None]
        stripe = 0.3 + 0.1 * np.sin(3 * where[:, 0]) / (1 + 0.1 * distance[below])
        colour[below], normal[below] = stripe[:, None] * [0.8, 1, 0.4], [0, -1, 0]
    if ball:
        along = rays @ camera.position
        inside = along**2 - camera.position @ camera.position + 0.25**2
        hit = inside > 0
        distance[hit] = -along[hit] - np.sqrt(inside[hit])
        normal[hit] = (camera.position + rays[hit] * distance[hit, None]) / 0.25
        colour[hit] = [0.5, 0.1, 0.05]
    return made(camera, colour, distance, normal)
