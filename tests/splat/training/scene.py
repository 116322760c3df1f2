"""A wall with a texture of its own, and a plain card that moves in front of it, made without a renderer."""

from __future__ import annotations

import numpy as np

from compose.camera.camera import camera_from_pose
from splat.training.moving_pixels import Observation

SIZE = 48
# Half the sides of the card, and its distance in front of the wall.
HALF, BEFORE = (0.35, 0.3), 0.8


def looking(x: float, y: float = 0.0):
    """A camera 3 before the wall at z = 0."""
    pose = np.eye(4)
    pose[:3, 3] = [x, y, -3]
    return camera_from_pose(pose, SIZE, SIZE, 50, 50, SIZE / 2, SIZE / 2)


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(..., 3) albedo that repeats nowhere."""
    waves = [np.sin(7 * x + 3 * y**2), np.sin(9 * y + 2 * x**2), np.sin(6 * (x - y) + x * y)]
    return 0.45 + 0.35 * np.stack(waves, axis=-1)


def observed(
    x: float,
    time: float,
    card: float | None = None,
    turned: float = 0.0,
    light: float = 1.0,
    albedo: bool = True,
) -> tuple[Observation, np.ndarray]:
    """A frame, and (H, W) which pixels show what moves.

    Args:
        x: of the camera.
        time: that the frame shows.
        card: where the card is; None for none.
        turned: radians by which a disc in the wall has turned in its plane; 0 for no disc.
        light: factor of the radiance.
        albedo: whether it is known.
    """
    camera = looking(x)
    rays = camera.rays(camera.pixel_centres())
    distance = 3 / rays[:, 2]
    points = camera.position + rays * distance[:, None]
    u, v = points[:, 0], points[:, 1]
    moves = np.hypot(u, v) < 0.6 if turned else np.zeros(len(u), dtype=bool)
    a, b = np.cos(turned) * u - np.sin(turned) * v, np.sin(turned) * u + np.cos(turned) * v
    colour = texture(np.where(moves, a, u), np.where(moves, b, v))
    if card is not None:
        near = (3 - BEFORE) / rays[:, 2]
        hit = camera.position + rays * near[:, None]
        on_card = (np.abs(hit[:, 0] - card) < HALF[0]) & (np.abs(hit[:, 1]) < HALF[1])
        distance, moves = np.where(on_card, near, distance), moves | on_card
        colour = np.where(on_card[:, None], [0.5, 0.1, 0.1], colour)
    shape = (SIZE, SIZE)
    colour = colour.reshape(*shape, 3).astype(np.float32)
    observation = Observation(
        camera,
        colour * np.float32(light),
        distance.reshape(shape).astype(np.float32),
        time,
        colour if albedo else None,
    )
    return observation, moves.reshape(shape)
